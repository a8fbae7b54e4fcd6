"""Errors of poses, as a distance and an angle, and by degree of freedom."""

import math
from collections.abc import Iterable

import numpy as np

from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, Array


def position_and_angle(errors: Array) -> tuple[float, float]:
    """Root mean square of distance, m, and of angle, deg, of errors ``(n, 5)`` in m and rad."""
    if not len(errors):
        return float("nan"), float("nan")
    position, angle = (np.sqrt((part**2).sum(axis=1).mean()) for part in np.split(errors, [3], 1))
    return float(position), float(np.degrees(angle))


def by_column(values: Iterable[float]) -> dict[str, float | None]:
    """Name values of the five degrees of freedom in m and deg, None where not finite."""
    names = (f"{name}_{unit}" for name, unit in zip(DOF_NAMES, DOF_UNITS, strict=True))
    known = (float(value) if math.isfinite(value) else None for value in values)
    return dict(zip(names, known, strict=True))
