"""The exact answer to a search by spectral angle, and questions that are easy to get wrong."""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from peers.libraries import Search
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.signature.spectral_angle import spectral_angle

ROUNDING_RAD = 2e-15  # rows whose angles differ by less are equally near to float64 unit vectors


def nearest_exactly(rows: Array, query: Array) -> set[int]:
    """Find the rows of least spectral angle by exact fractions.

    Parameters
    ----------
    rows
        Finite and not zero, shape ``(m, n)``.
    query
        Finite and not zero, shape ``(n,)``, of moderate size.

    Returns
    -------
    set of int
        The nearest row, with those that are as near to the last fraction.
    """
    cosines = rows @ query
    cosines /= np.sqrt(np.einsum("ij,ij->i", rows, rows)) * np.linalg.norm(query)
    # Far more than rounding, so the nearest row is among these.
    close = np.flatnonzero(cosines >= cosines.max() - 1e-13)
    exact = [Fraction(x) for x in query.tolist()]
    keys: dict[int, Fraction] = {}
    for row in close.tolist():
        vector = [Fraction(x) for x in rows[row].tolist()]
        dot = sum((a * b for a, b in zip(vector, exact, strict=True)), Fraction(0))
        # The cosine squared with its sign, but for the query's length.
        keys[row] = dot * abs(dot) / sum((a * a for a in vector), Fraction(0))
    largest = max(keys.values())
    return {row for row, key in keys.items() if key == largest}


def is_nearest(rows: Array, query: Array, found: int, truth: set[int]) -> bool:
    """Say whether a row is one of the truth, or as near to it as float64 can tell."""
    if not 0 <= found < len(rows):
        return False
    if found in truth:
        return True
    best = spectral_angle(rows[next(iter(truth))], query)
    return bool(spectral_angle(rows[found], query) <= best + ROUNDING_RAD)


@dataclass(frozen=True)
class HardCase:
    """A question with an exact answer: rows, query, the nearest rows and their angle, rad.

    ``rows_right`` is empty where there is no answer, so that only a refusal or NaN is right.
    """

    rows: Array
    query: Array
    rows_right: set[int]
    angle: float


def hard_cases(rows: Array) -> dict[str, HardCase]:
    """Make the questions that are easy to get wrong, out of at least 500 signatures."""
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    across = np.roll(rows[400], 1)
    across -= (across @ rows[400]) * rows[400]
    across /= np.linalg.norm(across)  # so that a step along it is an angle
    between = rows.copy()
    between[20] = rows[400] - 3e-9 * across
    near = rows[400] + 1e-9 * across
    twins = rows.copy()
    twins[[50, 250]] = rows[450]
    dark = rows.copy()
    dark[10] = 0.0
    aside = rows[450] + 1e-3 * across
    angle = float(spectral_angle(rows[450], aside))
    truth = nearest_exactly(twins, aside)
    dark_truth = {row + (row >= 10) for row in nearest_exactly(np.delete(dark, 10, 0), aside)}
    return {
        "1e-9 rad": HardCase(between, near, {400}, 1e-9),
        "equal rows": HardCase(twins, aside, truth, angle),
        "1e200 times": HardCase(rows, 1e200 * aside, nearest_exactly(rows, aside), angle),
        "zero row": HardCase(dark, aside, dark_truth, angle),
        "zero query": HardCase(rows, np.zeros(rows.shape[1]), set(), np.nan),
    }


def verdict(build: Callable[[Array], Search], case: HardCase) -> str:
    """Say in a few words how a peer answers a hard case; what is right starts with ``right``."""
    try:
        with np.errstate(all="ignore"):
            found, angles = build(case.rows)(case.query[None])
    except ValueError:
        refusable = not case.rows_right or not case.rows.any(axis=1).all()
        return "right: refused" if refusable else "refused"
    row, angle = int(found[0]), float(angles[0])
    if not case.rows_right:
        return f"row {row}, NaN" if np.isnan(angle) else f"row {row}, {angle:.2g} rad"
    if np.isnan(angle):
        return f"row {row}, NaN"
    if row not in case.rows_right:
        if row < 0 or not case.rows[row].any():
            return f"wrong row: {row}"
        return f"wrong row at {spectral_angle(case.rows[row], case.query):.1e} rad"
    if abs(angle - case.angle) > 1e-3 * case.angle:
        return f"wrong angle: {angle:.2g}"
    return "right"
