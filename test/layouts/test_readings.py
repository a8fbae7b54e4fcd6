"""What is told of places: courses by time, and parts that the light has to tell."""

import numpy as np
import pytest
from scenes import changed

from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.calibration.likelihood.likelihood import UNKNOWN_STD
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.layouts.readings import Course, read_table


def course(folder, text, max_gap_s=1.0):
    path = folder / "course.csv"
    path.write_text(text)
    return Course(read_table(path), max_gap_s)


def at(found, *seconds):
    return found.at(np.rint(np.array(seconds) * 1e9).astype(np.int64))


def test_a_course_is_interpolated_and_never_extrapolated(tmp_path):
    found = course(tmp_path, "time_s,x_m,yaw_deg\n1,-4,170\n2,-3,-170\n5,-2,-170\n6,-1,\n7,0,10\n")
    poses, rolls = at(found, 0.9, 1.5, 2.0, 3.0, 5.5, 7.1)
    np.testing.assert_allclose(poses[:, 0], [np.nan, -3.5, -3, np.nan, -1.5, np.nan])
    # The yaw goes the short way round, and is not told across the empty cell's gap.
    expected = np.radians([np.nan, 180, 190, np.nan, np.nan, np.nan])
    np.testing.assert_allclose(poses[:, 4], expected)
    assert np.isnan(poses[:, 1:4]).all()
    np.testing.assert_array_equal(rolls, 0)
    assert found.parts == [0, 4]


def test_a_course_may_roll(tmp_path):
    found = course(tmp_path, "time_s,z_m,roll_deg\n0,1,0\n1,1,20\n")
    _, rolls = at(found, 0.25, 2.0)
    np.testing.assert_allclose(rolls, [np.radians(5), np.nan])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("x_m\n1\n", "no column time_s; give the time of each pose"),
        ("time_s,a\n1,2\n", "has none of x_m, y_m, z_m, pitch_deg, yaw_deg, roll_deg"),
        ("time_s,x_m\n1,2\n2,\n", "x_m: 1 values; give values at two times or more"),
        ("time_s,x_m\n-1,2\n", "time_s: -1; give seconds from 0 to 9e"),
        ("time_s,x_m\n1,2,\n", None),
        ("time_s,x_std_m\n1,-2\n", "x_std_m: -2; it must be from 0 to 1000"),
        ("time_s,x_m\n", "no row below the columns"),
    ],
)
def test_a_bad_course_is_refused(tmp_path, text, told):
    if told is None:
        text, told = text.replace("2,", "inf"), "'inf' is not a number"
    with pytest.raises(ValueError, match=told):
        course(tmp_path, text)


def test_what_is_fitted_of_places_is_no_freedom_of_the_readings():
    """Of 25 readings an image, three unknown parts take three; the residual's mean square is 1."""
    scene = changed("follow", effects={"saturation": None, "adc": None})
    rng = np.random.default_rng(7)
    poses = rng.uniform([-6, -0.5, -0.5, -0.2, -0.2], [-3.5, 0.5, 0.5, 0.2, 0.2], (200, 5))
    model = ForwardModel(scene)
    images = model.expose(poses, rng)
    stds = np.array([1e-6, UNKNOWN_STD, UNKNOWN_STD, UNKNOWN_STD, 1e-6])
    names = [p.name for p in calibrate(scene, images, poses).parameters][:-1]
    found = calibrate(scene, images, poses, hold=[*names, "gains"], pose_std=stds)
    # A chi-square of 200 (25 - 3), 5 of its standard deviations; 3 / 25 are 7.
    assert abs(found.misfit - 1) < 5 * np.sqrt(2 / (200 * 22))
