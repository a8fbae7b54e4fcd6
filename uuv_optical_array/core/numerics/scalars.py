"""What the helpers of `elementwise` are for single numbers: plain Python, compiled or not."""

from typing import Any

import numpy as np

from uuv_optical_array.core.numerics import elementwise


def when(condition: Any, index: Any) -> Any:
    """As `elementwise.when`: the index itself, or nothing."""
    return range(index, index + (1 if condition else 0))


def choose(condition: Any, one: Any, other: Any) -> Any:
    """As `elementwise.choose`."""
    return one if condition else other


def choose_state(condition: Any, one: Any, other: Any) -> Any:
    """As `elementwise.choose_state`, of whole tuples."""
    return one if condition else other


def any_of(condition: Any) -> Any:
    """As `elementwise.any_of`, of one condition."""
    return condition


def not_(condition: Any) -> Any:
    """As `elementwise.not_`."""
    return not condition


def total(value: Any) -> Any:
    """As `elementwise.total`: of one number."""
    return value


def at_place(rows: Any, place: Any, index: Any) -> Any:
    """As `elementwise.at_place`."""
    return rows[int(place), index]


def room(rows: int, component: Any, count: int) -> Any:
    """As `elementwise.room`, of one pose."""
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
    elementwise.each: range,
    elementwise.when: when,
    elementwise.choose: choose,
    elementwise.choose_state: choose_state,
    elementwise.any_of: any_of,
    elementwise.not_: not_,
    elementwise.total: total,
    elementwise.at_place: at_place,
    elementwise.room: room,
    elementwise.zeros: zeros,
    np.maximum: larger,
    np.minimum: smaller,
}
