"""The vehicles' models by name."""

from typing import Literal

from uuv_optical_array.control.vehicles.bluerov2 import BlueRov2, BlueRov2Wu
from uuv_optical_array.control.vehicles.vehicle import Vehicle

Model = Literal["kinematic", "bluerov2", "bluerov2_wu"]
MODELS: dict[Model, type[Vehicle]] = {
    "kinematic": Vehicle,
    "bluerov2": BlueRov2,
    "bluerov2_wu": BlueRov2Wu,
}
