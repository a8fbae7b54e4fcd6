"""What lets one source serve NumPy and Numba: loops and choices for numbers and arrays alike.

A law is written once, for "the reading j". To NumPy j is a slice of all readings, to Numba a
number. Between them only the functions of this module differ (see `compiled_math`).
"""

import math
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np

Law = TypeVar("Law", bound=Callable[..., Any])
Arrays = TypeVar("Arrays")


def law(function: Law) -> Law:
    """Mark a function of numbers or arrays, without loops, to be compiled into its callers.

    So loops that call it become vectors: without this alone a frame takes 1.06 times as long, and
    1.23 times without what else they need (`compilation.FASTMATH`).
    """
    function.inline = True  # type: ignore[attr-defined]
    return function


def exp(x: Any) -> Any:
    """Return what `numpy.exp` returns."""
    return np.exp(x)


def sin(x: Any) -> Any:
    """Return what `numpy.sin` returns, of up to a hundred turns to 1e-13."""
    return math.sin(x) if finite_number(x) else np.sin(x)


def cos(x: Any) -> Any:
    """Return what `numpy.cos` returns, of up to a hundred turns to 1e-13."""
    return math.cos(x) if finite_number(x) else np.cos(x)


def finite_number(x: Any) -> bool:
    """Say whether a value is a finite number, for which `math` takes a tenth of NumPy's time."""
    return isinstance(x, float) and math.isfinite(x)


def expm1(x: Any) -> Any:
    """Return what `numpy.expm1` returns."""
    return np.expm1(x)


def maximum(x: Any, low: Any) -> Any:
    """Return what `numpy.maximum` returns; a NaN in the place of `low` may get lost."""
    return np.maximum(x, low)


def minimum(x: Any, high: Any) -> Any:
    """Return what `numpy.minimum` returns; a NaN in the place of `high` may get lost."""
    return np.minimum(x, high)


def borrowed(arrays: Arrays) -> Arrays:
    """Return a named tuple of arrays as it is, for as long as the caller keeps it.

    Compiled code hands on its address, and counts no references to its arrays. None of them may be
    returned, nor a tuple made of its large members.
    """
    return arrays


def indices(count: int) -> Iterable[Any]:
    """Iterate over the last axis: once by a slice here, by numbers in compiled code."""
    return (slice(None),)


def indices_where(condition: Any, index: Any) -> Iterable[Any]:
    """Iterate over the places of an `indices` index, of one axis, where a condition holds."""
    chosen = np.flatnonzero(condition)
    return (chosen,) if len(chosen) else ()


def choose(condition: Any, one: Any, other: Any) -> Any:
    """Return one value where a condition holds and another where not."""
    return np.where(condition, one, other)


def choose_tuple(condition: Any, one: Any, other: Any) -> Any:
    """Choose between named tuples: whole by one condition, by many along their parts' last axis."""
    if np.ndim(condition) == 0:
        return one if condition else other
    return type(one)(*(np.where(condition, a, b) for a, b in zip(one, other, strict=True)))


def any_of(condition: Any) -> bool:
    """Say whether a condition holds anywhere."""
    return bool(np.any(condition))


def total(values: Any) -> Any:
    """Sum what one turn of an `indices` loop holds: an array's last axis, or a number itself."""
    return np.add.reduce(values, axis=-1)


def workspace(rows: int, component: Any, count: int) -> Any:
    """Return an empty array of rows of `count` readings, for each pose of a component or row."""
    return np.empty((rows, *np.shape(component)[:-1], count))


def stack(*components: Any) -> Any:
    """Return components as an array, the component first."""
    return np.array(np.broadcast_arrays(*components), dtype=float)


def zeros(rows: int, columns: int, component: Any) -> Any:
    """Return a small matrix of zeros for each pose of a component."""
    return np.zeros((rows, columns, *np.shape(component)))


def sandwich(matrix: Any, images: Any) -> None:
    """Turn images, shape ``(rows, ..., side^2)``, into ``M image M'``, in place."""
    side = len(matrix)
    for image in images:  # one by one, as each takes as much memory again
        planes = image.reshape(*image.shape[:-1], side, side)
        image[...] = (matrix @ planes @ matrix.T).reshape(image.shape)


def beside(own: Any, i: int, image: Any) -> None:
    """Write the i-th of several images of one size, side by side on the last axis."""
    n = own.shape[-1]
    image[..., i * n : (i + 1) * n] = own


def partition(values: Any, n: int) -> None:
    """Bring the value that is n-th when they are sorted there, and what is less before it."""
    values.partition(n)


def at_place(rows: Any, place: Any, index: Any) -> Any:
    """Return, for each column of an `indices` index, the row of its own place."""
    return np.take_along_axis(rows, np.asarray(place, dtype=np.intp)[None], axis=0)[0]
