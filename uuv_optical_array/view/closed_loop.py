"""The whole loop without ROS: vehicles, sea, lamp, array, estimator, track and formation law."""

import dataclasses
from typing import Annotated, Any

import numpy as np

from uuv_optical_array.control.formation import STATION, FormationController, FormationSettings
from uuv_optical_array.control.sea import CURRENT, Sea
from uuv_optical_array.control.vehicles import Vehicle, lead, start_behind
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array, relative_pose
from uuv_optical_array.core.settings import Numbers, Place, Quantity, check
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import LAMP_POWER, power_offsets
from uuv_optical_array.forward.scene import Scene, load_scene, scene_from_settings
from uuv_optical_array.view.sight import Sight, note_on, sight_of

CLOUDS = "night_plume"  # the ready scene whose clouds drift where a scene has none


@dataclasses.dataclass(frozen=True)
class Conditions:
    """The sea that the estimator does not know, and the station; ValueError beyond the bounds."""

    k_per_m: Annotated[float, Quantity("attenuation or absorption of the water", "1/m", 0, 10)]
    lamp_power: Annotated[Numbers, LAMP_POWER] = (1.0,)
    plume_depth: Annotated[
        float, Quantity("optical depth in the middle of a cloud; 0: none", "", 0, 20)
    ] = 0.0
    current_m_per_s: Annotated[Place, CURRENT] = (0.0, 0.0, 0.0)
    station_m: Annotated[Place, STATION] = FormationSettings.station_m

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            check(field.type, getattr(self, field.name), field.name)
        FormationSettings(station_m=self.station_m)

    @classmethod
    def of(cls, scene: Scene) -> "Conditions":
        """Return those of a scene."""
        plume_depth = scene.effects.get("plume", {}).get("depth", 0.0)
        return cls(scene.attenuation[1], (1.0,) * scene.lamp_count, plume_depth)


class ClosedLoop:
    """A leader on its path, and a follower that keeps station by its light alone.

    As on ROS the leader waits for the first command. The estimator believes its scene, of which the
    conditions are unless others are given. `frames` holds the stages that an image goes through.
    """

    def __init__(
        self, estimator: Estimator, rng: np.random.Generator, conditions: Conditions | None = None
    ) -> None:
        self._rng = rng
        self._scene = scene = estimator.scene
        self.conditions = conditions or Conditions.of(scene)
        self.frames = Pipeline(estimator)
        self._controller = FormationController(FormationSettings())
        self.t_s = 0.0
        self._path_s: float | None = None  # on the leader's path, once the follower is commanded
        self._command: tuple[Array, Array] = np.zeros(3), np.zeros(3)
        self._leader = Vehicle(np.zeros(3))
        self.change(self.conditions)
        self._follower = start_behind(self._leader, self.conditions.station_m)

    def change(self, conditions: Conditions) -> None:
        """Set other conditions."""
        self._model, self._offsets = _sea(self._scene, conditions)
        self._controller.configure(FormationSettings(station_m=conditions.station_m))
        self.conditions = conditions

    def step(self, dt: float) -> Sight:
        """Advance by `dt`, s, > 0; return what there is to see, the lamp at the leader's origin."""
        if self._path_s is not None:
            # The current acts once the vehicles move.
            self._leader.sea = self._follower.sea = Sea(self.conditions.current_m_per_s)
            self._path_s = lead(self._leader, self._path_s, dt)
        self._follower.step(*self._command, dt)
        self.t_s += dt
        at, turn = self._leader.position, self._leader.rotation
        pose, roll = relative_pose(at, turn, self._follower.position, self._follower.rotation)
        image = self._model.read(self._model.light(pose, roll, self._offsets, self.t_s), self._rng)
        frame = self.frames.answer(round(self.t_s * 1e9), image)
        track = frame.track
        if track is not None:
            try:
                self._controller.update(self.t_s, track.pose, track.covariance, track.rate)
            except (NoPose, ValueError) as reason:
                frame = frame._replace(reason=str(reason))
        command = self._controller.command(self.t_s)
        if command is not None:
            self._command = command
            self.frames.command(round(self.t_s * 1e9), *command)
            if self._path_s is None:
                self._path_s = 0.0
        waits = "the leader waits for its follower to see it" if self._path_s is None else ""
        words = {"note": note_on(frame) or waits, "station_m": self.conditions.station_m}
        return sight_of(frame, self.t_s, image, pose, leader=(at, turn), **words)


def _sea(scene: Scene, conditions: Conditions) -> tuple[ForwardModel, dict[str, Any]]:
    """Return the model of a scene that can have clouds, and its offsets."""
    settings = scene.settings()
    effects = settings["effects"]
    clouds = effects.pop("plume", None)
    name, believed = scene.attenuation
    # The offset is what differs, as the lamp stays as bright as it is in the scene.
    offsets = {name: np.array(conditions.k_per_m - believed)}
    offsets |= power_offsets(conditions.lamp_power, scene.lamp_count)
    if conditions.plume_depth > 0:
        clouds = clouds or load_scene(CLOUDS).effects["plume"]
        effects["plume"] = {**clouds, "depth": conditions.plume_depth}
    return ForwardModel(scene_from_settings(settings, scene.name)), offsets
