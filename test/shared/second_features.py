"""The five key parameters written a second time, one detector after the other."""

from fractions import Fraction

import numpy as np
from scipy import stats


def slow_skewness(values):
    return 0.0 if max(values) == min(values) else float(stats.skew(values))


def slow_vertex(profile, index):
    if index in (0, len(profile) - 1):
        return float(index)
    a, b, _ = np.polyfit([-1.0, 0.0, 1.0], profile[index - 1 : index + 2], 2)
    return index - b / (2 * a)


def slow_key_parameters(image, full_scale, peak):
    """One image, detector by detector, as the documentation words it."""
    image = [[float(value) for value in line] for line in image]
    side = len(image)
    brightest = max(max(line) for line in image)
    if brightest == 0:
        return [0.0] * 5
    top = [(r, c) for r in range(side) for c in range(side) if image[r][c] == brightest]
    # Fractions: detectors that are as near as each other must not differ by rounding.
    middle_row = Fraction(sum(r for r, _ in top), len(top))
    middle_column = Fraction(sum(c for _, c in top), len(top))
    # min keeps the first of equals: the one that is read first, line by line.
    row, column = min(top, key=lambda p: (p[0] - middle_row) ** 2 + (p[1] - middle_column) ** 2)
    horizontal = image[row]
    vertical = [line[column] for line in image]
    if peak == "detector":
        at_row, at_column = row, column
    else:
        flat_down, flat_across = len({r for r, _ in top}) > 1, len({c for _, c in top}) > 1
        at_row = float(middle_row) if flat_down else slow_vertex(vertical, row)
        at_column = float(middle_column) if flat_across else slow_vertex(horizontal, column)
    centre = (side - 1) / 2
    return [
        brightest / full_scale,
        at_column - centre,
        at_row - centre,
        slow_skewness(np.gradient(horizontal)),
        slow_skewness(np.gradient(vertical)),
    ]
