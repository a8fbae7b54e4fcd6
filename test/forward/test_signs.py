"""Which way the bright spot moves for each degree of freedom, as geometry demands.

Row 0 is the top and column 0 the port edge, seen from behind the array.
"""

import numpy as np
import pytest
from scenes import make_scene

from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.forward.model import ForwardModel

AHEAD = np.array([-6.0, 0.0, 0.0, 0.0, 0.0])
OFFSET = {"y": (1, 0.5), "z": (2, 0.5), "pitch": (3, np.radians(15)), "yaw": (4, np.radians(15))}


@pytest.fixture(params=[("planar", 5), ("curved", 6)], ids=["planar", "curved, even"])
def model(request):
    return ForwardModel(make_scene(*request.param, effects={}))


def at(dof, sign=1):
    index, amount = OFFSET[dof]
    pose = AHEAD.copy()
    pose[index] = sign * amount
    return pose


def spot(model, pose, roll=0.0):
    """Column and row of the brightness centroid, from the centre of the array."""
    image = model.light(pose, roll)
    offsets = np.arange(model.array.side) - (model.array.side - 1) / 2
    return image.sum(axis=0) @ offsets / image.sum(), image.sum(axis=1) @ offsets / image.sum()


def peak(model, pose):
    """Column and row of the peak among the five key parameters."""
    return key_parameters(model.light(pose), 900.0, "subdetector")[1:3]


@pytest.mark.parametrize(
    ("dof", "along", "sign"),
    [
        ("y", 0, +1),  # follower to port: spot to starboard, in a higher column
        ("z", 1, +1),  # follower above: spot lower, in a higher row
        ("yaw", 0, +1),  # bow to port: spot to starboard
        ("pitch", 1, -1),  # bow down: spot higher, towards row 0
    ],
)
def test_centroid_and_peak_move_along_one_image_axis_only(model, dof, along, sign):
    for where in (spot, peak):
        plus, minus = where(model, at(dof)), where(model, at(dof, -1))
        assert sign * plus[along] > 1e-3
        assert minus[along] == pytest.approx(-plus[along], rel=1e-9), "mirrored pose"
        assert plus[1 - along] == pytest.approx(0, abs=1e-9), "no other axis"
