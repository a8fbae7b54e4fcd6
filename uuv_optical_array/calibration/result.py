"""What a calibration found."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.calibration.fit.beam_shape import ResidualsByAngle
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.scene import Scene


@dataclass(frozen=True)
class FittedParameter:
    """One fitted number, with name and unit of the scene, before and after."""

    name: str
    unit: str
    start: float
    value: float
    std: float  # with the effect of what is held though unknown; nan where this one was held
    note: str = ""  # why it was held, or what it is correlated with


@dataclass(frozen=True)
class Calibration:
    """The result of a calibration of m images of n readings."""

    # The starting scene with the fitted values, and their errors in its prior; itself where it is
    # refused and no scene can have them.
    scene: Scene
    # What the scene has of `parameters.Layout`; the reference reading by it; the noise, if fitted.
    parameters: tuple[FittedParameter, ...]
    # By how much poses of each place are off those given, m and rad, (k, 5); empty: exact ones.
    shifts: Array
    gains: Array  # geometric mean 1, (side, side)
    gain_std: Array  # nan where one was held, (side, side)
    correlation: Array  # of the parameters before the reference reading; nan where one was held
    residuals: Array  # of every reading, standard deviations, (m, n)
    by_angle: ResidualsByAngle  # off the beam's axis
    used: NDArray[np.bool_]  # readings that were fitted: no outliers, not faulty, (m, n)
    uncensored: NDArray[np.bool_]  # used readings that are far from both limits, (m, n)
    # Mean squared residual of these, 1 if explained; above `notes.MISFIT` errors grow by its root.
    misfit: float
    outliers: int  # single readings that were left out
    outlying_images: tuple[int, ...]  # that were left out
    notes: tuple[str, ...]  # what a user should know
    refusal: str  # why the scene is not to be used; empty: it is
    clock: tuple[float, float] = (0.0, math.inf)  # as of `offset_step`, s; inf without rates
