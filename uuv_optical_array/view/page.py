"""The page: leader, follower, beam and array in 3-D beside charts.

The lamp keeps its place and heading in the picture, and the world moves past it, so that the camera
stands still. Where the leader's place is not known, the lamp's frame is the world.
"""

import errno
import logging
import math
import secrets
import socket
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from io import StringIO
from typing import Any, NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from uuv_optical_array.core import geometry
from uuv_optical_array.core.extras import needs
from uuv_optical_array.core.geometry import PITCH, YAW, Array
from uuv_optical_array.forward.array import build_array
from uuv_optical_array.forward.lamp.lamps import together
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.plots.follow import FOLLOWERS, LEADER
from uuv_optical_array.plots.style import IMAGES
from uuv_optical_array.view import LOOPBACK, PORT
from uuv_optical_array.view.charts import ESTIMATE, Charts
from uuv_optical_array.view.guard import guarded
from uuv_optical_array.view.shapes import beams, body, ellipsoid
from uuv_optical_array.view.sight import Sight, Window
from uuv_optical_array.view.words import headline, words

PORTS_TRIED = 1000
CHARTS_EVERY = 3  # sights; drawing the charts takes ten times as long as the rest
PATH_POINTS = 300  # of a vehicle's path behind it
STEP_M = 0.2  # between them
FLOOR_M, SECTION_M = 2.5, 5.0  # below where the leader starts; of the lines on it
NIGHT, LAMP = (7, 24, 46), (255, 214, 110)
WIDE = 0.8  # aspect, width by height, from which on a picture shows leader and follower
WIDTH_PX, LEFT_PX, IMAGE_PX = 360, 300, 250
FAINT = 0.01  # of full scale; an image that is darker is not drawn brighter, as it may be noise
GAPS = (0, 0), (0, 2), (0, 0)  # pixels beside the image of each lamp


class Slider(NamedTuple):
    """A slider: what it sets, with its unit; a hint; and its range, step and value in that unit."""

    label: str
    hint: str
    low: float
    high: float
    step: float
    value: float


class Page:
    """A page about a scene's lamp and array, served at `port`, or the next that is free.

    NotInstalled without viser, ValueError where no page can be served at `host` and `port`.
    """

    def __init__(self, scene: Scene, title: str, host: str = LOOPBACK, port: int = PORT) -> None:
        viser = needs("view", "viser")
        self._scene = scene
        port = _free_port(host, port)
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)  # browsers that hang up
        token = secrets.token_urlsafe(16)
        with guarded(token), redirect_stdout(StringIO()):  # no option suppresses its banner
            self._server = viser.ViserServer(host, port, label=title, verbose=False)
        # A browser may ask viser for a tunnel through which the whole internet sees the page.
        self._server.request_share_url = lambda verbose=True: None
        host = f"[{host}]" if ":" in host else host
        self.url = f"http://{host}:{self._server.get_port()}/{token}"
        self._window, self._drawn = Window(), 0
        self._paths: dict[str, list[Array]] = {"leader": [], "follower": []}
        self._again = ""  # the button that restarts
        self._range_m = -scene.table.x_m[0]
        self._floor_at: tuple[float, float] | None = None
        self._draw_sea()
        self._draw_vehicles()
        self._lay_out(title)

    def close(self) -> None:
        """Serve no more."""
        with redirect_stdout(StringIO()):
            self._server.stop()

    def _draw_sea(self) -> None:
        server, sea = self._server, self._server.scene
        server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        dusk = np.linspace(1.7, 0.5, 64)[:, None, None] * np.array(NIGHT)  # lighter above
        sea.set_background_image(np.clip(dusk, 0, 255).astype(np.uint8).repeat(64, axis=1))
        sea.configure_default_lights(cast_shadow=False)
        camera = server.initial_camera
        camera.position, camera.look_at = _seen_from(self._range_m, WIDE)
        camera.fov = np.radians(50)
        server.on_client_connect(self._aim)
        self._sea = sea.add_frame("/sea", show_axes=False)
        lines = {"cell_size": 1.0, "section_size": SECTION_M, "fade_distance": 45.0}
        colours = {"cell_color": (38, 66, 98), "section_color": (58, 94, 134)}
        self._floor = sea.add_grid("/sea/floor", 80.0, 80.0, **lines, **colours)
        self._floor.position = 0.0, 0.0, -FLOOR_M

    def _aim(self, client: Any) -> None:
        """Aim a browser's camera, and anew whenever it is where it is at first, or reset."""

        def aim(camera: Any) -> None:
            begun, _ = _seen_from(self._range_m, WIDE)
            if camera.aspect < WIDE and np.allclose(camera.position, begun, atol=1e-3):
                camera.position, camera.look_at = _seen_from(self._range_m, camera.aspect)

        client.camera.on_update(aim)
        aim(client.camera)

    def _draw_vehicles(self) -> None:
        sea, array = self._server.scene, build_array(self._scene.array)
        half_m = max(self._scene.array.bow_m, 0.3)
        names = "leader", "follower", "estimate", "station"
        self._frames = {name: sea.add_frame(f"/{name}", show_axes=False) for name in names}
        # The lamp is at the leader's origin, at its stern; the ellipsoid is in the follower.
        for name, colour, ahead, opacity in (
            ("leader", LEADER, half_m + 0.05, None),
            ("follower", FOLLOWERS[0], 0.0, 0.5),
        ):
            look = {"color": _rgb(colour), "opacity": opacity, "side": "double"}
            for part, mesh in body(half_m).items():
                at = ahead, 0.0, 0.0
                sea.add_mesh_simple(f"/{name}/{part}", *mesh, position=at, **look)
            sea.add_label(f"/{name}/label", name, position=(0.0, 0.0, 1.6 * half_m))
        light = {"color": LAMP, "side": "front", "material": "toon3"}  # a far wall hides nothing
        self._lights: list[list[Any]] = []  # ball and cones of each lamp
        for i, (place, meshes) in enumerate(beams(self._scene, self._range_m)):
            ball = {"subdivisions": 2, "position": tuple(place)}
            shapes = [sea.add_icosphere(f"/leader/lamp_{i}", 0.09, LAMP, **ball)]
            for stds, (mesh, opacity) in enumerate(zip(meshes, (0.2, 0.1), strict=True), 1):
                name = f"/leader/beam_{i}_{stds}_sigma"
                shapes.append(sea.add_mesh_simple(name, *mesh, opacity=opacity, **light))
            self._lights.append(shapes)
        dark = np.zeros((len(array.positions), 3), np.uint8)
        dots = {"point_shape": "circle", "point_shading": "flat", "precision": "float32"}
        size = {"point_size": 0.5 * array.spacing_m, **dots}
        self._detectors = sea.add_point_cloud("/follower/array", array.positions, dark, **size)
        frame = {"wireframe": True, "subdivisions": 2}  # as transparent bodies hide each other
        self._ellipsoid = sea.add_icosphere("/estimate/three_sigma", 1.0, _rgb(ESTIMATE), **frame)
        ends = half_m * np.array([[2.0, 0, 0], [0, 0.7, 0], [0, -0.7, 0], [0, 0, 1.2]])
        axes = np.stack([np.zeros((4, 3)), ends], axis=1)
        sea.add_line_segments("/estimate/axes", axes, _rgb(ESTIMATE), thickness=0.025)
        sea.add_label("/estimate/label", "estimate, 3 sigma", position=(0.0, 0.0, -1.6 * half_m))
        cross = 0.3 * np.stack([-np.eye(3), np.eye(3)], axis=1)
        sea.add_line_segments("/station/cross", cross, (255, 255, 255), thickness=0.02)
        sea.add_label("/station/label", "station", position=(-1.0, 0.0, 0.0))
        for name in ("follower", "estimate", "station"):
            self._frames[name].visible = False

    def _lay_out(self, title: str) -> None:
        # A phone shows the main panel, and the others below it.
        gui = self._server.gui
        gui.set_panel_label(title.removeprefix("uuv_optical_array: "))
        gui.main_panel.dock_left()
        gui.main_panel.set_width(LEFT_PX)
        by_lamp = " by each lamp" if self._scene.lamps else ""
        label = f"image of the array{by_lamp}, port on the left, up on top"
        self._state = gui.add_html(headline(None, 0.0))
        self._words = gui.add_html("")
        # Below the sliders, so that a phone shows these together with the state.
        black, last = np.zeros((8, 8, 3), np.uint8), math.inf
        self._image = gui.add_image(black, label=label, format="png", order=last)
        right = gui.add_panel()
        right.dock_right()
        right.set_width(WIDTH_PX)
        with right.add_tab("last minute"):
            self._charts = Charts(gui, self._scene.full_scale_counts)

    def add_sliders(
        self, title: str, sliders: Sequence[Slider], on_change: Callable[[list[float]], None]
    ) -> None:
        """Add sliders; `on_change` gets all values, from any thread; its ValueError resets them."""
        handles: list[Any] = []
        taken = [slider.value for slider in sliders]

        def changed(event: Any) -> None:
            try:
                if event.client is not None:  # else they go back
                    on_change(values := [handle.value for handle in handles])
                    taken[:] = values
            except ValueError as error:
                for handle, value in zip(handles, taken, strict=True):
                    handle.value = value
                logging.getLogger(__name__).warning("refused: %s", error)

        with self._server.gui.add_folder(title):
            for label, hint, *span in sliders:
                handles.append(self._server.gui.add_slider(label, *span, hint=hint))
                handles[-1].on_update(changed)

    def add_button(self, label: str, on_click: Callable[[], None]) -> None:
        """Add a button that restarts; `on_click` is called from any thread."""
        self._again = label
        self._server.gui.add_button(label).on_click(lambda _: on_click())

    def add_time_line(
        self, duration_s: float, on_change: Callable[[float, bool], None]
    ) -> Callable[[float], None]:
        """Add a time line with a switch that lets time run; return what moves it to a time, s.

        `on_change` gets, from any thread, the time that was chosen, s, and whether time runs.
        """
        end_s = max(math.ceil(10 * duration_s) / 10, 0.1)
        with self._server.gui.add_folder("recording"):
            line = self._server.gui.add_slider("time (s)", 0.0, end_s, 0.1, 0.0)
            runs = self._server.gui.add_checkbox("play", True)

        def chosen(event: Any) -> None:
            if event.client is not None:  # not by `move`
                on_change(line.value, runs.value)

        def move(t_s: float) -> None:
            line.value = round(t_s, 1)

        line.on_update(chosen)
        runs.on_update(chosen)
        return move

    def show(self, sight: Sight) -> None:
        """Draw an instant; one that is not later than the last starts a new run."""
        begins = self._window.add(sight)
        if begins:
            self._paths = {name: [] for name in self._paths}
        with self._server.atomic():
            self._show_vehicles(sight)
            self._state.content = headline(sight.state, sight.t_s, self._again)
            self._words.content = words(sight, *self._window.poses())
            if sight.image is not None:
                self._show_image(sight.image)
            self._drawn += 1
            if begins or self._drawn % CHARTS_EVERY == 0:
                self._charts.show(self._window)

    def remember(self, sights: Sequence[Sight]) -> None:
        """Replace what the charts show by these sights."""
        self._window.clear()
        for sight in sights:
            self._window.add(sight)
        if sights:
            self._charts.show(self._window)

    def _show_image(self, image: Array) -> None:
        faint = FAINT * self._scene.full_scale_counts
        self._detectors.colors = _coloured(together(image), faint).reshape(-1, 3)
        side = image.shape[1]
        lamps = _coloured(image, faint).reshape(-1, side, side, 3)
        cell = np.ones((max(1, IMAGE_PX // (side * len(lamps))),) * 2 + (1,), np.uint8)
        beside = np.hstack([np.pad(np.kron(lamp, cell), GAPS) for lamp in lamps])
        self._image.image = beside[:, : -GAPS[1][1]]

    def _show_vehicles(self, sight: Sight) -> None:
        place, attitude = sight.leader or (np.zeros(3), np.eye(3))
        _, _, yaw = geometry.roll_pitch_yaw(attitude)
        heading = geometry.rotation_matrix(0.0, yaw)
        turn = heading.T @ attitude
        frames = self._frames
        _place(frames["leader"], np.zeros(3), turn)
        _place(self._sea, -heading.T @ place, heading.T)
        x, y = SECTION_M * np.rint(place[:2] / SECTION_M)  # so that the floor has no end
        if (x, y) != self._floor_at:
            self._floor_at, self._floor.position = (x, y), (x, y, -FLOOR_M)
        for lit, shapes in zip(sight.lit or (), self._lights, strict=False):
            for shape in shapes:
                shape.visible = lit
        self._show_pose("follower", sight.true_pose, turn)
        self._show_pose("estimate", sight.pose, turn)
        if sight.station_m is not None:
            _place(frames["station"], turn @ np.array(sight.station_m), turn)
        frames["station"].visible = sight.station_m is not None
        if sight.pose is not None and sight.covariance is not None:
            pitch, yaw = sight.pose[[PITCH, YAW]]
            scale, axes = ellipsoid(sight.covariance[:3, :3], geometry.rotation_matrix(pitch, yaw))
            self._ellipsoid.scale = tuple(scale)
            self._ellipsoid.wxyz = _wxyz(axes)
        if sight.leader is not None:
            self._follow_path("leader", place, LEADER)
            if sight.true_pose is not None:
                self._follow_path("follower", place + attitude @ sight.true_pose[:3], FOLLOWERS[0])

    def _show_pose(self, name: str, pose: Array | None, turn: Array) -> None:
        frame = self._frames[name]
        frame.visible = pose is not None
        if pose is not None:
            _place(frame, turn @ pose[:3], turn @ geometry.rotation_matrix(pose[PITCH], pose[YAW]))

    def _follow_path(self, name: str, at: Array, colour: str) -> None:
        path = self._paths[name]
        if path and np.linalg.norm(path[-1] - at) < STEP_M:
            return
        path.append(at)
        del path[:-PATH_POINTS]
        points = np.array([*path, at])
        segments = np.stack([points[:-1], points[1:]], axis=1)
        scene, name = self._server.scene, f"/sea/{name}_path"
        scene.add_line_segments(name, segments, _rgb(colour), thickness=0.03)


def _seen_from(range_m: float, aspect: float) -> tuple[Array, Array]:
    """Return where the camera is and where it looks, by the lamp's range and the picture's aspect.

    A narrow picture is taken from farther away, and shows leader and follower in its upper part: on
    a phone the panels cover the lower one.
    """
    farther = max(1.0, WIDE / aspect)
    middle = range_m * np.array([-0.42, 0.0, 0.04])
    place = middle + farther * range_m * np.array([-0.29, -1.4, 0.38])
    return place, middle - range_m * np.array([0.0, 0.0, farther - 1.0])


def _free_port(host: str, port: int) -> int:
    """Return the first free port from `port` on; viser waits for ever for a bad address."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for candidate in range(port, min(port + PORTS_TRIED, 65536)):
        try:
            socket.create_server((host, candidate), family=family).close()
            return candidate
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise ValueError(
                    f"host: {host!r} cannot be served at port {candidate} ({error}); give "
                    f"{LOOPBACK}, or 0.0.0.0 for the network, and a port above 1023"
                ) from None
    raise ValueError(f"port: none is free from {port} on; give another")


def _place(frame: Any, position: Array, turn: Array) -> None:
    frame.position, frame.wxyz = position, _wxyz(turn)


def _wxyz(turn: Array) -> Array:
    return np.roll(Rotation.from_matrix(turn).as_quat(), 1)


def _coloured(image: Array, faint: float) -> NDArray[np.uint8]:
    colours: NDArray[np.uint8] = colormaps[IMAGES](image / max(image.max(), faint), bytes=True)
    return colours[..., :3]


def _rgb(colour: str) -> tuple[int, ...]:
    return tuple(round(255 * part) for part in to_rgb(colour))
