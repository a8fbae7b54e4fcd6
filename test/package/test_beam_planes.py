"""What of a lamp's planes an aim and an ellipse explain, by beams that are made."""

import numpy as np
import pytest

from uuv_optical_array.forward.lamp.photometric_files import Photometry
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.studies.measured_light.lamps import MeasuredLamp, scene_of

ANGLES = np.arange(0.0, 60.5, 0.5)
AROUND = np.arange(16) * np.pi / 8


@pytest.fixture
def planes():
    return pytest.importorskip("beam_planes", reason="the benchmarks are not installed")


def lamp_of(rows):
    return Photometry(ANGLES, np.array(rows), np.full(len(rows), 1 / len(rows)))


def gaussian(tilt_deg=0.0, stretch=0.0):
    """A Gaussian of 12 deg, tilted towards the first plane, and wider along it."""
    polar, around = np.radians(ANGLES), AROUND[:, None]
    tilt = np.radians(tilt_deg)
    cosine = np.sin(polar) * np.cos(around) * np.sin(tilt) + np.cos(polar) * np.cos(tilt)
    off = np.degrees(np.arccos(np.clip(cosine, -1, 1))) / (1 + stretch * np.cos(2 * around))
    return lamp_of(np.exp(-0.5 * (off / 12) ** 2))


def test_a_round_beam_leaves_nothing(planes):
    found = planes.planes_of(gaussian(), AROUND)
    assert max(found["planes"], found["aimed"], found["elliptic"]) < 1e-3


def test_a_tilted_beam_is_explained_by_its_aim(planes):
    found = planes.planes_of(gaussian(tilt_deg=2.0), AROUND)
    assert found["planes"] > 30
    assert found["aim_deg"] == pytest.approx(2.0, abs=0.05)
    assert found["aimed"] < 4  # the mean about the wrong axis is a little wider
    assert found["stretch"] < 0.01


def test_an_elliptic_beam_is_explained_by_its_ellipse_alone(planes):
    found = planes.planes_of(gaussian(stretch=0.1), AROUND)
    assert found["aim_deg"] < 0.05
    assert found["aimed"] == pytest.approx(found["planes"], rel=1e-3)
    assert found["stretch"] == pytest.approx(0.1, abs=0.01)
    assert found["elliptic"] < 0.15 * found["planes"]


def test_light_by_equal_planes_is_that_of_their_mean_and_turns_with_the_planes(planes):
    model = ForwardModel(scene_of({"beam_sigma_deg": 12.0}))
    poses = np.array([[-4.0, 0.5, -0.3, 0.1, -0.2], [-5.0, -0.4, 0.6, 0.0, 0.15]])
    for lamp in (gaussian(), lamp_of(np.tile(np.exp(-0.5 * (ANGLES / 9) ** 2), (4, 1)))):
        by_mean = MeasuredLamp(lamp, model).light(poses)
        np.testing.assert_allclose(planes.Planes(lamp, model).light(poses), by_mean, rtol=1e-9)
    # A beam that is brighter to port, which is the first plane's side.
    light = planes.Planes(gaussian(tilt_deg=3.0), model).light(np.array([[-4.0, 0, 0, 0, 0]]))[0]
    port, starboard = light[:, 0].sum(), light[:, -1].sum()
    assert port > 1.05 * starboard
    assert light[0].sum() == pytest.approx(light[-1].sum(), rel=1e-6)


def test_a_file_of_one_plane_has_no_figures(planes, tmp_path):
    numbers = [1, -1, 1.0, len(ANGLES), 1, 1, 2, 0.1, 0.1, 0, 1, 1, 40, *ANGLES, 0]
    numbers += list(np.exp(-0.5 * (ANGLES / 12) ** 2))
    body = "\n".join(f"{number:g}" for number in numbers)
    path = tmp_path / "round.ies"
    path.write_text(f"IESNA:LM-63-2002\nTILT=NONE\n{body}\n", encoding="latin-1")
    head, row = planes.report([path]).splitlines()
    assert row.split() == ["round", "1", *["-"] * 5]
    assert head.split()[:2] == ["lamp", "planes"]
