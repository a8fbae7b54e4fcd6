"""What the helpers of `elementwise` are for single numbers: plain Python, compiled or not."""

from typing import Any

import numpy as np

from uuv_optical_array.core.numerics import elementwise


def indices_where(condition: Any, index: Any) -> Any:
    """As `elementwise.indices_where`: the index itself, or nothing."""
    return range(index, index + (1 if condition else 0))


def choose(condition: Any, one: Any, other: Any) -> Any:
    """As `elementwise.choose`."""
    return one if condition else other


def choose_tuple(condition: Any, one: Any, other: Any) -> Any:
    """As `elementwise.choose_tuple`, of whole tuples."""
    return one if condition else other


def any_of(condition: Any) -> Any:
    """As `elementwise.any_of`, of one condition."""
    return condition


def logical_not(condition: Any) -> Any:
    """As `elementwise.logical_not`."""
    return not condition


def total(value: Any) -> Any:
    """As `elementwise.total`: of one number."""
    return value


def at_place(rows: Any, place: Any, index: Any) -> Any:
    """As `elementwise.at_place`."""
    return rows[int(place), index]


def workspace(rows: int, component: Any, count: int) -> Any:
    """As `elementwise.workspace`, of one pose."""
    return np.empty((rows, count))


def zeros(rows: int, columns: int, component: Any) -> Any:
    """As `elementwise.zeros`, of one pose."""
    return np.zeros((rows, columns))


def larger(a: Any, b: Any) -> Any:
    """As `numpy.maximum`, of numbers."""
    return a if a > b else b


def smaller(a: Any, b: Any) -> Any:
    """As `numpy.minimum`, of numbers."""
    return a if a < b else b


BY_NUMBER: dict[Any, Any] = {
    elementwise.indices: range,
    elementwise.indices_where: indices_where,
    elementwise.choose: choose,
    elementwise.choose_tuple: choose_tuple,
    elementwise.any_of: any_of,
    elementwise.logical_not: logical_not,
    elementwise.total: total,
    elementwise.at_place: at_place,
    elementwise.workspace: workspace,
    elementwise.zeros: zeros,
    np.maximum: larger,
    np.minimum: smaller,
}
