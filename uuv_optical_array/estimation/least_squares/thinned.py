"""A large array seen through few of its detectors, with which a fit of all begins.

The number of steps to a minimum hardly depends on the number of readings, but the time of a step is
proportional to it. So the first steps use every k-th detector of a large array, in its rows and
columns, and only the last ones use all.
"""

from typing import Any

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.least_squares.problem import Problem
from uuv_optical_array.forward.optics import Optics

GAPS = 8  # between the detectors that are kept of a row, at least; of fewer all are


def kept_of(side: int) -> Any:
    """Return which detectors of a row are kept, about the middle."""
    every = max((side - 1) // GAPS, 1)
    return np.arange((side - 1) % every // 2, side, every)


def readings_of(side: int, lamps: int) -> Any:
    """Return the readings of the detectors that are kept, of one lamp after the other."""
    kept = kept_of(side)
    return np.add.outer(np.arange(lamps) * side**2, np.add.outer(side * kept, kept)).reshape(-1)


def thinned_blur(blur: Array, side: int) -> Array:
    """Return the blur of one axis of the detectors that are kept, linear between these."""
    if not len(blur):
        return blur
    kept = kept_of(side)
    between = [np.interp(np.arange(side), kept, one) for one in np.eye(len(kept))]
    return np.ascontiguousarray(blur[kept] @ np.transpose(between))


def thinned_optics(optics: Optics, readings: Any, blur: Array) -> Optics:
    """Return the optics of few detectors.

    - readings, blur: as of `readings_of` and `thinned_blur`.
    """
    detectors = readings[: len(readings) // optics.lamps.shape[1]]
    return optics._replace(
        detectors=np.ascontiguousarray(optics.detectors[:, detectors]),
        step_values=np.ascontiguousarray(optics.step_values[:, readings]),
        blur=blur,
    )


def thinned(problem: Problem, readings: Any, blur: Array) -> Problem:
    """Return the problem of few of the readings, as `thinned_optics`."""
    return problem._replace(
        optics=thinned_optics(problem.optics, readings, blur),
        spans=problem.spans * len(readings) // len(problem.readings),
        readings=problem.readings[readings],
        weights=problem.weights[readings],
    )
