"""Draw an array with the coordinates of its detectors: ``python docs/sphere.py SCENE FILE.svg``.

All of it comes from the scene's detectors; ``examples/detectors.py`` prints the same figures.
"""

import sys
from pathlib import Path

import numpy as np
from drawings import GREY, INK, dot, line, picture, words
from numpy.typing import NDArray

from uuv_optical_array import Scene, load_scene
from uuv_optical_array.forward.array import build_array

SEAT_MM = 18.0  # diameter of a detector's disc
LOOK = "#c9a227"
WIDTH, SIDE = 1120, 420  # px, of the drawing and of the view from ahead
HEAD = "no  row  col    x / mm      y      z     yaw / deg  pitch   tilt"


def seats(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return places from the sphere's centre, mm, and yaw, pitch and tilt, deg, ``(n, 3)`` each."""
    array = build_array(scene.array)
    x, y, z = array.normals.T
    places = 1e3 * (array.positions - [scene.array.bow_m, 0, 0])
    return places, np.degrees([np.arctan2(y, x), -np.arcsin(z), np.arccos(x)]).T


def from_ahead(scene: Scene, left: float, top: float) -> list[str]:
    """Return the array as the lamp sees it, port at the right, with y and z of each seat."""
    places, angles = seats(scene)
    scale = SIDE / 2 / max(1e3 * (scene.array.radius_m or 0), 1.2 * places[:, 1].max())
    middle = np.array([left, top]) + SIDE / 2
    parts = [words(left, top - 16, "from ahead (x towards you), mm", font_weight="bold")]
    if scene.array.radius_m:
        radius = 1e3 * scene.array.radius_m * scale
        parts.append(dot(*middle, radius, fill="none", stroke=GREY, stroke_dasharray="5 4"))
    for i, (place, (_, _, tilt)) in enumerate(zip(places, angles, strict=True)):
        x, y = middle + scale * place[1:] * [1, -1]
        turn, half = np.degrees(np.arctan2(-place[2], place[1])), SEAT_MM / 2 * scale
        parts += [
            f'<ellipse rx="{half * np.cos(np.radians(tilt)):.1f}" ry="{half:.1f}" fill="#eee" '
            f'stroke="{INK}" transform="translate({x:.1f} {y:.1f}) rotate({turn:.1f})"/>',
            words(x + 15, y - 4, str(i), text_anchor="middle", font_size=13),
        ]
    for value in np.unique(places[:, 1].round(6)) + 0.0:
        text, across = f"{value:g}", middle[0] + scale * value
        parts.append(words(across, top + SIDE + 18, text, text_anchor="middle", font_size=13))
        up = middle[1] - scale * value + 5
        parts.append(words(left - 8, up, text, text_anchor="end", font_size=13))
    parts.append(
        words(left + SIDE + 4, top + SIDE + 18, "y: to port", text_anchor="end", fill=GREY)
    )
    parts.append(words(left - 8, top + 14, "z: up", text_anchor="end", fill=GREY))
    return parts


def from_above(scene: Scene, left: float, top: float) -> list[str]:
    """Return the middle row from above: sphere, seats, and how far each looks aside."""
    places, angles = seats(scene)
    side = scene.array.detectors_per_side
    row = slice(side * (side // 2), side * (side // 2 + 1))
    reach = max(1e3 * (scene.array.radius_m or 0), np.abs(places[:, 1]).max())
    scale = SIDE / 2 / reach
    centre = np.array([left, top + SIDE / 2])
    parts = [words(left, top - 16, "middle row from above (z towards you)", font_weight="bold")]
    if scene.array.radius_m:
        swept = np.linspace(-np.pi / 2, np.pi / 2, 61)
        arc = reach * np.stack([np.cos(swept), -np.sin(swept)], axis=1)
        parts.append(line(centre + scale * arc, stroke=GREY, stroke_dasharray="5 4"))
        x, y = centre
        parts.append(words(x + 8, y + 130, f"centre; radius {reach:g} mm", font_size=13))
        parts.append(line([[x, y], [x + 28, y + 116]], stroke=GREY))
    parts.append(dot(*centre))
    for i, (place, (yaw, _, _)) in enumerate(zip(places[row], angles[row], strict=True)):
        look = np.array([np.cos(np.radians(yaw)), -np.sin(np.radians(yaw))])
        x, y = at = centre + scale * place[:2] * [1, -1]
        half = SEAT_MM / 2 * scale * np.array([-look[1], look[0]])
        parts.append(line([centre, at], stroke="#ddd"))
        parts.append(line([at - half, at + half], stroke_width=4))
        parts.append(line([at, at + 26 * look], stroke=LOOK, stroke_width=2))
        name = f"{row.start + i}: x {place[0]:.1f}, y {place[1] + 0:g}; {yaw + 0:.1f} deg"
        parts.append(words(x + 34 * look[0], y + 40 * look[1] + 5, name, font_size=13))
    return parts


def listed(scene: Scene, left: float, top: float) -> list[str]:
    """Return the table of all seats, in two columns."""
    lines = []
    side = scene.array.detectors_per_side
    for i, numbers in enumerate(np.hstack(seats(scene)).round(1) + 0.0):
        x, y, z, yaw, pitch, tilt = numbers
        lines.append(
            f"{i:2d}  {i // side:3d}  {i % side:3d}  {x:8.1f} {y:7.1f} {z:7.1f}"
            f"  {yaw:8.1f}    {pitch:6.1f} {tilt:6.1f}"
        )
    half, parts = -(-len(lines) // 2), []
    for k, part in enumerate((lines[:half], lines[half:])):
        for number, text in enumerate([HEAD, *part]):
            style = {"font_weight": "bold"} if number == 0 else {}
            at = left + WIDTH / 2 * k, top + 17 * number
            mono = {"font_family": "DejaVu Sans Mono, monospace", "style": "white-space: pre"}
            parts.append(words(*at, text, font_size=12, **mono, **style))
    return parts


def sphere(scene: Scene) -> str:
    """Return the drawing of a scene's array, SVG."""
    rows = -(-(scene.array.detectors_per_side**2) // 2) + 1
    top = SIDE + 130
    parts = from_ahead(scene, 80, 50) + from_above(scene, 620, 50) + listed(scene, 24, top)
    return picture(WIDTH, top + 17 * rows + 10, parts)


if __name__ == "__main__":
    Path(sys.argv[2]).write_text(sphere(load_scene(sys.argv[1])), encoding="utf-8")
    print(f"drawing: {sys.argv[2]}")
