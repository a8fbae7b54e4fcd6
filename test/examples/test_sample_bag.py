"""The sample bag of the tutorials is what its script writes, and a fit finds the script's sea."""

import inspect
import runpy
from pathlib import Path

import numpy as np
import pytest
from command_line import run
from needs import rosbags

from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.commands import calibrate as command
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.recording.images import read_recording

EXAMPLES = Path(__file__).parents[2] / "examples"

pytestmark = rosbags


@pytest.fixture(scope="module")
def sample():
    return read_recording(EXAMPLES / "sample", load_scene("follow").array)


def test_it_is_what_its_script_writes(sample, monkeypatch, tmp_path):
    monkeypatch.setattr("sys.argv", ["sample_bag", str(tmp_path / "again")])
    names = runpy.run_path(str(EXAMPLES / "sample_bag.py"), run_name="__main__")
    again = read_recording(tmp_path / "again", load_scene("follow").array)
    np.testing.assert_array_equal(again.stamps_ns, sample.stamps_ns)
    # Where a reading lies between two counts, rounding may choose the other.
    assert np.abs(again.images - sample.images).max() <= 1
    assert (again.images == sample.images).mean() > 0.999
    true = np.array(
        [names["relative"](t)[0] for t in np.arange(names["IMAGES"]) / names["RATE_HZ"]]
    )
    np.testing.assert_allclose(sample.poses, true, atol=1e-9)
    assert sum(file.stat().st_size for file in (EXAMPLES / "sample").iterdir()) < 2**20


def test_errors_of_poses_reach_the_fit_in_metres_and_degrees(tmp_path, monkeypatch):
    given = {}

    def fit(*words, **named):
        given.update(inspect.signature(calibrate).bind(*words, **named).arguments)
        raise ValueError("no fit is needed")

    monkeypatch.setattr(command, "calibrate", fit)
    words = ("--set", "position_std_m=0.05", "--set", "attitude_std_deg=1")
    line = run("calibrate", EXAMPLES / "sample", *words, "-o", tmp_path / "sea.yaml", code=1)
    assert "no fit is needed" in line
    wanted = [0.05, 0.05, 0.05, np.radians(1), np.radians(1)]
    np.testing.assert_allclose(given["pose_std"], np.broadcast_to(wanted, given["poses"].shape))


def test_what_is_no_parameter_is_refused_before_the_bag_is_read(tmp_path):
    line = run("calibrate", tmp_path / "no_bag", "--hold", "lamp.gaussian", code=2)
    assert "hold lamp.gaussian: unknown; choose from lamp.power, lamp.beam_sigma_deg," in line
    assert "beam_weights" not in line
    assert line.endswith("ambient.level_counts, gains")
