"""What studies share: results on disk, and errors of methods that take turns."""

import csv
import math

import numpy as np
import pytest
from measured import row

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.forward.working_volume import uniform_poses
from uuv_optical_array.studies.shared.errors import (
    FrameErrors,
    frame_errors,
    position_and_angle,
    range_across_angle,
)
from uuv_optical_array.studies.shared.results import read, write
from uuv_optical_array.studies.tradeoff import Measurement

ORIGIN = {"scene": "sea", "fingerprint": "f" * 64, "machine": "a, b: 2 cores"}
ORIGIN |= {"mode": "quick", "frames": 7, "seed": 1}
COLUMNS = ["scene", "fingerprint", "machine", "mode", "frames", "seed", "method", "shape"]


def test_a_file_of_rows_reads_back_and_is_plain_csv(tmp_path):
    rows = [row(position=0.1 + 0.2, bound_position_m=math.inf), row("moments", angle=math.nan)]
    path = tmp_path / "t.csv"
    write(path, ORIGIN, [vars(one) for one in rows])
    origin, found = read(path, Measurement)
    assert origin == {name: str(value) for name, value in ORIGIN.items()}
    assert [str(vars(a)) for a in found] == [str(vars(b)) for b in rows]
    with path.open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert list(lines[0])[:8] == COLUMNS
    assert (lines[0]["machine"], lines[0]["position_m"]) == ("a, b: 2 cores", repr(0.1 + 0.2))
    assert len(path.read_text().splitlines()) == 3
    assert [file.name for file in tmp_path.iterdir()] == ["t.csv"]


@pytest.mark.parametrize(
    ("spoil", "number"),
    [
        (lambda text: text[:-30], 2),
        (lambda text: text.replace("curved,5", "curved,five"), 2),
        (lambda text: "a,b\n1,2\n", 2),
        (lambda text: text + text.splitlines()[1].replace(",quick,7,1,", ",quick,7,2,") + "\n", 3),
        (lambda text: text + "sea,", 3),
    ],
)
def test_damaged_files_are_refused_in_one_line(tmp_path, spoil, number):
    path = tmp_path / "t.csv"
    write(path, ORIGIN, [vars(row())])
    path.write_text(spoil(path.read_text()))
    error = rf"t\.csv: line {number} is damaged, or .*; remove the file or name another"
    with pytest.raises(ValueError, match=error):
        read(path, Measurement)


def test_errors_are_distance_and_angle():
    errors = np.array([[3.0, 0, 4, 0, 0], [0, 0, 0, np.radians(3), np.radians(-4)]])
    assert position_and_angle(errors) == pytest.approx((5 / math.sqrt(2), 5 / math.sqrt(2)))
    assert np.isnan(position_and_angle(np.empty((0, 5)))).all()
    assert range_across_angle([2, 3, 4, 6, 8]) == pytest.approx((2, 5 / 2**0.5, 10 / 2**0.5))


def test_errors_are_those_of_the_answers():
    yardstick = ForwardModel(load_scene("reference"))
    poses = uniform_poses(4, np.random.default_rng(0))
    images = np.arange(4.0)[:, None, None] * np.ones((3, 3))

    def answer(image):
        i = int(image[0, 0])
        if i == 2:
            raise NoPose("none")
        return poses[i] - 2.0, (i + 1) * np.eye(5)

    found = frame_errors(answer, yardstick, poses, images, range(4))
    np.testing.assert_allclose(found.errors[[0, 1, 3]], -2.0)
    assert found.posed.tolist() == [True, True, False, True]
    np.testing.assert_allclose(found.covariances[[0, 1, 3], 2, 2], [1, 2, 4])
    assert np.isnan(found.covariances[2]).all()
    assert (found.frame_s > 0).all()
    assert found.frame_ms[0] <= found.frame_ms[1]
    assert found.model_ms > 0


def test_errors_of_poses_are_what_they_are_beyond_the_truth():
    truth, spread = np.full((2, 5), 0.5), np.diag(np.arange(1.0, 6.0))
    found = FrameErrors.untimed([(np.array([1.0, 0, 0.5, 0, 0]), spread), None], truth)
    np.testing.assert_array_equal(found.errors[0], [0.5, -0.5, 0, -0.5, -0.5])
    np.testing.assert_array_equal(found.covariances[0], spread)
    assert found.posed.tolist() == [True, False]
