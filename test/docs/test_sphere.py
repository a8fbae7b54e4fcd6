"""The drawing of an array shows its detectors where the scene has them."""

import re
import subprocess
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
from generate_reference import drawing
from pages import ROOT

from uuv_optical_array.forward.scene import load_scene

SPACE = "{http://www.w3.org/2000/svg}"


@pytest.mark.parametrize("name", ["follow", "eren2016"])
def test_seats_lie_and_look_as_the_law_of_the_array_says(name, tmp_path):
    """By eqs 9 to 12 of Eren et al. (2016), written out here; port is at the right, up is up."""
    words = [sys.executable, ROOT / "docs/sphere.py", name, tmp_path / "array.svg"]
    told = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    assert told == f"drawing: {tmp_path / 'array.svg'}\n"
    array = load_scene(name).array
    side, half, radius = array.detectors_per_side, array.width_m / 2, array.radius_m
    drawn = ElementTree.parse(tmp_path / "array.svg").getroot()
    seats = list(drawn.iter(f"{SPACE}ellipse"))
    assert len(seats) == side**2
    at = np.array(
        [
            [float(number) for number in re.findall(r"-?[\d.]+", seat.get("transform"))[:2]]
            for seat in seats
        ]
    )
    y = half - 2 * half * (np.arange(side**2) % side) / (side - 1)
    z = half - 2 * half * (np.arange(side**2) // side) / (side - 1)
    scale = (at[0, 0] - at[side - 1, 0]) / (2 * half)
    middle = at.mean(axis=0)
    np.testing.assert_allclose(at, middle + scale * np.stack([y, -z], axis=1), atol=0.1)
    cosine = np.sqrt(radius**2 - y**2 - z**2) / radius if radius else np.ones(side**2)
    ratio = [float(seat.get("rx")) / float(seat.get("ry")) for seat in seats]
    np.testing.assert_allclose(ratio, cosine, atol=0.1 / float(seats[0].get("ry")))


def test_the_table_of_the_drawing_has_the_corners_coordinates():
    """0.32 m, and 0.2 m to port and up: by Pythagoras and the arc tangent."""
    drawn = ElementTree.fromstring(drawing("sphere.svg"))
    texts = [text.text for text in drawn.iter(f"{SPACE}text")]
    (line,) = [text for text in texts if text.startswith(" 0  ")]
    x = (320**2 - 2 * 200**2) ** 0.5
    angles = np.degrees([np.arctan2(200, x), -np.arcsin(200 / 320), np.arccos(x / 320)])
    expected = [0, 0, 0, x, 200, 200, *angles]
    np.testing.assert_allclose([float(word) for word in line.split()], expected, atol=0.051)
