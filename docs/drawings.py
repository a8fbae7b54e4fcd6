"""Drawings of the geometry and of the nodes, as SVG, for ``docs/generate_reference.py``.

What they show is computed: places and readings by the default scene, topics by the nodes' source.
"""

from collections.abc import Iterable, Sequence
from html import escape

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array import ForwardModel, load_scene
from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.core.geometry import rotation_matrix
from uuv_optical_array.forward.array import build_array

POSE = np.array([-4.9, 0.45, 0.3, np.radians(20), np.radians(20)])  # m and rad
SCALE = 105.0  # pixels to a metre
FAR_M, HALF_HEIGHT_M = 6.3, 1.35  # of what is drawn of the beam
INK, GREY, LIGHT, BEAM = "#111", "#666", "#ddd", "#c9a227"
PIPELINE = ("vehicles", "simulator", "feature", "estimator", "formation")


def line(points: ArrayLike, close: bool = False, **style: object) -> str:
    """Return a line through points, px, shape ``(n, 2)``, or the area that they enclose."""
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in np.asarray(points))
    kind = "polygon" if close else "polyline"
    return f'<{kind} points="{path}"{written({"fill": "none", "stroke": INK} | style)}/>'


def words(x: float, y: float, text: str, **style: object) -> str:
    """Return a text whose base line begins at a point, px."""
    return f'<text x="{x:.1f}" y="{y:.1f}"{written(style)}>{escape(text)}</text>'


def dot(x: float, y: float, radius: float = 4, **style: object) -> str:
    """Return a filled circle, px."""
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}"{written(style)}/>'


def written(style: dict[str, object]) -> str:
    """Return attributes as SVG has them."""
    return "".join(f' {key.replace("_", "-")}="{value}"' for key, value in style.items())


def arrow(start: ArrayLike, end: ArrayLike, **style: object) -> str:
    """Return an arrow between two points, px."""
    return line([start, end], marker_end="url(#head)", **style)


def picture(width: int, height: int, parts: Iterable[str]) -> str:
    """Return an SVG on white paper, so that it is read on a dark page, too."""
    head = (
        '<defs><marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" '
        'markerHeight="8" orient="auto-start-reverse"><path d="M0,1 L10,5 L0,9 z"/></marker></defs>'
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}" font-family="DejaVu Sans, Verdana, Arial, sans-serif" '
        f'font-size="15">\n<rect width="{width}" height="{height}" fill="white"/>\n{head}\n'
        + "\n".join(parts)
        + "\n</svg>\n"
    )


class View:
    """A view of the frame ``beacon`` with x to the right: from above, or from starboard."""

    def __init__(self, up: int, left_px: float, middle_px: float) -> None:
        self.up, self.origin = up, np.array([left_px, middle_px])

    def at(self, places: ArrayLike) -> NDArray[np.float64]:
        """Return the pixels of places in the lamp's frame, m, shape ``(..., 3)``."""
        places = np.asarray(places, dtype=float)
        flat = np.stack([places[..., 0], -places[..., self.up]], axis=-1)
        return self.origin + SCALE * flat

    def vehicle(self, place: ArrayLike, turn: NDArray[np.float64], half_m: float) -> list[str]:
        """Return the outline of a vehicle, with its fin astern."""
        round_ = np.linspace(0, 2 * np.pi, 41)
        outline = np.zeros((41, 3))
        outline[:, 0] = half_m * np.cos(round_)
        outline[:, self.up] = 0.4 * half_m * np.sin(round_)
        return [line(self.at(place + outline @ turn.T), True, fill="#eee", stroke_width=1.5)]

    def axes(self, place: ArrayLike, turn: NDArray[np.float64], length_m: float) -> list[str]:
        """Return x and the axis that points up, with their names."""
        parts = []
        for axis in (0, self.up):
            start, end = self.at(place), self.at(place + length_m * turn[:, axis])
            parts.append(arrow(start, end, stroke_width=2))
            x, y = end + 13 * (end - start) / np.linalg.norm(end - start)
            parts.append(words(x - 4, y + 5, "xyz"[axis], font_weight="bold"))
        return parts


def view_of(up: int, title: str, left_px: float, middle_px: float) -> list[str]:
    """Return a view: leader, lamp, beam, station, and the follower at `POSE` with its signs."""
    scene = load_scene("follow")
    view, turn = View(up, left_px, middle_px), rotation_matrix(POSE[3], POSE[4])
    half_m, still = scene.array.bow_m, np.eye(3)
    parts = [words(18, middle_px - 170, title, font_weight="bold", font_size=17)]
    for stds, shade in ((2, "#f6efd2"), (1, "#ead99a")):
        slope = np.tan(stds * np.radians(scene.lamp.beam_sigma_deg))
        side = min(FAR_M * slope, HALF_HEIGHT_M)
        ends = np.zeros((5, 3))
        ends[:, 0] = [0, -side / slope, -FAR_M, -FAR_M, -side / slope]
        ends[:, up] = [0, side, side, -side, -side]
        parts.append(line(view.at(ends), True, fill=shade, stroke="none"))
    parts.append(line(view.at([[-FAR_M, 0, 0], [0, 0, 0]]), stroke=GREY, stroke_dasharray="6 4"))
    parts += view.vehicle([half_m + 0.05, 0, 0], still, half_m)
    parts.append(dot(*view.at(np.zeros(3)), 7, fill=BEAM, stroke=INK))
    parts += view.axes(np.zeros(3), still, 0.95)
    # The follower, its axes, and the detectors of the middle row or column.
    side_count = scene.array.detectors_per_side
    detectors = build_array(scene.array).positions.reshape(side_count, side_count, 3)
    row = detectors[side_count // 2] if up == 1 else detectors[:, side_count // 2]
    parts += view.vehicle(POSE[:3], turn, row[:, 0].min() + 0.05)
    parts += [dot(*place, 3.5, fill=INK) for place in view.at(POSE[:3] + row @ turn.T)]
    parts += view.axes(POSE[:3], turn, 0.95)
    parts.append(dot(*view.at(POSE[:3])))
    # The place: x along the axis, y or z from it.
    name, value = "xyz"[up], POSE[up]
    foot = np.array([POSE[0], 0.0, 0.0])
    lifted = foot + value * still[up]
    parts.append(arrow(view.at(foot), view.at(lifted), stroke_dasharray="3 3"))
    x, y = view.at((foot + lifted) / 2)
    where = "to port" if up == 1 else "up"
    parts.append(words(x - 72, y + 1, f"{name} +{value:g} m", text_anchor="end"))
    parts.append(words(x - 72, y + 19, where, text_anchor="end"))
    low = view.at([[0.0, 0, 0], [POSE[0], 0, 0]]) + np.array([0, 95])
    parts.append(arrow(*low, stroke=INK))
    tick = np.array([0, 8])
    parts += [line([end - tick, end + tick]) for end in low]
    parts.append(
        words(low.mean(axis=0)[0] - 150, low[0][1] - 7, f"x {POSE[0]:g} m: behind the lamp")
    )
    # The angle from the leader's x to the follower's.
    angle = POSE[4] if up == 1 else -POSE[3]
    swept = np.linspace(0, angle, 15)
    arc = np.zeros((15, 3))
    arc[:, 0], arc[:, up] = 1.2 * np.cos(swept), 1.2 * np.sin(swept)
    parts.append(
        line(view.at(POSE[:3] + np.outer([0, 1.5], still[0])), stroke=GREY, stroke_dasharray="3 3")
    )
    parts.append(line(view.at(POSE[:3] + arc), marker_end="url(#head)", stroke_width=1.5))
    x, y = view.at(POSE[:3] + [1.25, 0, 0] + 0.2 * np.sign(angle) * still[up])
    turned = f"yaw +{np.degrees(POSE[4]):.0f} deg: bow to port"
    if up == 2:
        turned = f"pitch +{np.degrees(POSE[3]):.0f} deg: bow down"
    parts.append(words(x + 8, y + 5, turned))
    x, y = view.at(FormationSettings.station_m)
    parts += [line([[x - 8, y - 8], [x + 8, y + 8]], stroke_width=2.5)]
    parts += [line([[x - 8, y + 8], [x + 8, y - 8]], stroke_width=2.5)]
    parts.append(words(x - 8, y + 38, f"station ({FormationSettings.station_m[0]:g}, 0, 0) m"))
    return parts


def geometry() -> str:
    """Return the drawing of lamp, beam, array, station, axes and signs, and an image."""
    x, y = 690, 190
    parts = view_of(1, "from above (z towards you)", x, y)
    parts += view_of(2, "from starboard (y away from you)", x, y + 362)
    parts += [
        words(x + 12, y + 66, "leader or dock:"),
        words(x + 12, y + 86, "lamp and frame beacon at"),
        words(x + 12, y + 106, "the origin, beam along -x"),
        words(36, y + 132, "beam: 1 and 2 standard deviations"),
        words(24, y + 48, "follower: base_link,"),
        words(24, y + 67, "array at its bow"),
    ]
    parts += image(880, 390)
    return picture(1120, 720, parts)


def image(left_px: float, top_px: float) -> list[str]:
    """Return what the array of the default scene reads at `POSE`, counts."""
    readings = np.rint(ForwardModel(load_scene("follow")).expected(POSE)).astype(int)
    cell, parts = 44, [words(left_px - 60, top_px - 34, "what the array reads there (counts)")]
    for (row, column), value in np.ndenumerate(readings):
        x, y = left_px + cell * column, top_px + cell * row
        grey = round(255 * value / readings.max())
        parts.append(
            f'<rect x="{x}" y="{y}" width="{cell}" height="{cell}" '
            f'fill="rgb({grey},{grey},{grey})" stroke="{GREY}"/>'
        )
        ink = INK if grey > 128 else "white"
        parts.append(
            words(x + cell / 2, y + 28, str(value), text_anchor="middle", fill=ink, font_size=13)
        )
    side = len(readings)
    for i in range(side):
        middle = cell * (i + 0.5)
        parts.append(words(left_px + middle, top_px - 6, str(i), text_anchor="middle"))
        parts.append(words(left_px - 12, top_px + middle + 5, str(i), text_anchor="middle"))
    end = top_px + cell * side
    parts += [
        words(left_px - 60, end + 20, "column 0: port"),
        words(left_px + cell * side, end + 20, "4: starboard", text_anchor="end"),
        words(left_px - 60, top_px + 18, "row"),
        words(left_px - 60, end + 44, "The lamp is to starboard of the bow"),
        words(left_px - 60, end + 62, "and above it, and so is the spot."),
    ]
    return parts


def nodes(topics: Sequence[tuple[str, bool, str, str]]) -> str:
    """Return the drawing of the nodes and of what they publish and subscribe to.

    `topics` are node, whether published, name and type, as ``reference_pages.nodes.all_topics``.
    """
    names = {node for node, *_ in topics}
    order = [f"{name}_node" for name in PIPELINE if f"{name}_node" in names]
    order += sorted(names - set(order))
    column = {name: 325 + 145 * i for i, name in enumerate(order)}
    ends: dict[tuple[str, str], tuple[list[float], list[float]]] = {}
    for node, published, name, kind in topics:
        ends.setdefault((name, kind), ([], []))[not published].append(column[node])

    def place(item: tuple[tuple[str, str], tuple[list[float], list[float]]]) -> tuple[float, str]:
        (name, _), (publishers, listeners) = item
        return min(publishers or listeners), name

    width, height = 305 + 145 * len(order), 150 + 46 * len(ends)
    parts = []
    for first, last, text in (
        ("vehicles", "simulator", "in simulation alone"),
        ("feature", "formation", "on the follower; all three in one: follower_node"),
    ):
        left, right = column[f"{first}_node"] - 66, column[f"{last}_node"] + 66
        parts.append(line([[left, 36], [left, 28], [right, 28], [right, 36]], stroke=GREY))
        middle = (left + right) / 2
        parts.append(words(middle, 20, text, text_anchor="middle", font_size=13))
    for name, x in column.items():
        parts.append(
            f'<rect x="{x - 69}" y="42" width="138" height="34" rx="6" fill="#eee" stroke="{INK}"/>'
        )
        parts.append(words(x, 64, name, text_anchor="middle", font_weight="bold", font_size=14))
        parts.append(line([[x, 76], [x, height - 52]], stroke=LIGHT, stroke_width=2))
    for number, ((name, kind), (publishers, listeners)) in enumerate(
        sorted(ends.items(), key=place)
    ):
        y = 110 + 46 * number
        parts.append(words(12, y, name, font_weight="bold"))
        parts.append(words(12, y + 17, kind.partition("/")[2], fill=GREY, font_size=12))
        starts = publishers or [240.0]
        for start in starts:
            for x in listeners:
                if x != start:
                    end = x - 7 * np.sign(x - start)
                    parts.append(arrow([start, y], [end, y], stroke_width=1.5))
        if not listeners:
            parts += [arrow([x, y], [x + 60, y], stroke_width=1.5) for x in publishers]
        parts += [dot(x, y, 6, fill=INK) for x in publishers]
        # A node that does both, in different roles, has both marks side by side.
        at = [x - 15 * (x in publishers) for x in listeners]
        parts += [dot(x, y, 6, fill="white", stroke=INK, stroke_width=2) for x in at]
    y = height - 18
    parts += [
        dot(20, y - 5, 6, fill=INK), words(32, y, "publishes"),
        dot(130, y - 5, 6, fill="white", stroke=INK, stroke_width=2), words(142, y, "subscribes"),
        words(250, y, "an arrow from or to no node: from or to other programs or vehicles"),
    ]  # fmt: skip
    return picture(width, height, parts)
