"""What `elementwise` and some functions of NumPy and SciPy are in compiled code.

Exponential, logarithm and trigonometric functions are polynomials, which a compiler turns into
vectors; the library's would be a call for each number.
"""

import math
from functools import partial
from typing import Any

import numpy as np
from llvmlite import ir
from numba import carray, njit, types
from numba.extending import intrinsic
from scipy import special

from uuv_optical_array.core.numerics import elementwise

# sin(x) / x and cos(x) by powers of x^2 up to pi / 2, highest first: minimax, right to 3e-19.
SINE = (
    *(2.7215660921125597e-15, -7.643025738964345e-13, 1.6058940847832492e-10),
    *(-2.505210688997513e-08, 2.7557319211223257e-06, -0.00019841269841208638),
    *(0.008333333333333186, -0.16666666666666666, 1.0),
)
COSINE = (
    *(-1.51197786600161e-16, 4.776871733415368e-14, -1.1470670142864075e-11),
    *(2.087675566605353e-09, -2.755731920964734e-07, 2.4801587301492586e-05),
    *(-0.001388888888888853, 0.04166666666666666, -0.5, 1.0),
)
# exp by powers up to log(2) / 2, highest first: minimax, right to 3e-18.
EXPONENTIAL = (
    *(2.5110037605963777e-08, 2.763263963904103e-07, 2.755724091857897e-06),
    *(2.4801485482328494e-05, 0.00019841269890047113, 0.0013888888952314775),
    *(0.008333333333319601, 0.0416666666664881, 0.1666666666666668),
    *(0.5000000000000019, 1.0, 1.0),
)
# log((1 + s) / (1 - s)) / s by powers of s^2, highest first: Taylor's, right to 1e-18 of a log.
LOGARITHM = tuple(2 / (2 * k + 1) for k in range(11, -1, -1))
ROOT_HALF = np.float64(math.sqrt(0.5)).view(np.int64)
LOG2_HIGH, LOG2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # their sum
PI_HIGH, PI_LOW = 3.1415926534682512, 1.2154201013012384e-10
SMALLEST = -708.0  # logarithm of the smallest number that is not subnormal, nearly
ROUND = 1.5 * 2.0**52  # added to a number it leaves the nearest whole one in the last bits
MOST_ON_STACK = 4096  # numbers
ASYMPTOTIC = 25.0  # from here a series of the scaled complementary error function is exact

within = partial(njit, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
inner, inlined = within(), within(forceinline=True, fastmath={"contract"})


@inlined
def polynomial(coefficients, x):
    """Evaluate a polynomial by Horner's rule, highest power first."""
    value = coefficients[0]
    for coefficient in coefficients[1:]:
        value = value * x + coefficient
    return value


@inlined
def exponential(x):
    """Return exp(x) of a number up to 700, 0 below `SMALLEST`."""
    shifted = x * (1 / math.log(2)) + ROUND
    power = shifted - ROUND
    value = polynomial(EXPONENTIAL, x - power * LOG2_HIGH - power * LOG2_LOW)
    # Times 2^power: it is in the last bits of `shifted`, and goes to the exponent's.
    bits = np.float64(value).view(np.int64) + (np.float64(shifted).view(np.int64) << np.int64(52))
    return 0.0 if x < SMALLEST else np.int64(bits).view(np.float64)


@inlined
def exponential_less_one(x):
    """Return exp(x) - 1 of a number up to 700."""
    shifted = x * (1 / math.log(2)) + ROUND
    power = shifted - ROUND
    rest = x - power * LOG2_HIGH - power * LOG2_LOW
    bits = (np.float64(shifted).view(np.int64) + np.int64(1023)) << np.int64(52)
    scale = np.int64(bits).view(np.float64)
    value = scale * (rest * polynomial(EXPONENTIAL[:-1], rest)) + (scale - 1)
    return -1.0 if x < SMALLEST else value


@inlined
def logarithm(x):
    """Return log(x) of a number that is not subnormal; nan below 0 and of what is not finite."""
    bits = np.float64(x).view(np.int64)
    # The power of two that leaves a fraction from sqrt(1/2) to sqrt(2).
    power = (bits - ROOT_HALF) >> np.int64(52)
    fraction = np.int64(bits - (power << np.int64(52))).view(np.float64)
    s = (fraction - 1) / (fraction + 1)
    value = power * LOG2_HIGH + (power * LOG2_LOW + s * polynomial(LOGARITHM, s * s))
    return value + (x - x) if x > 0 else (-np.inf if x == 0 else np.nan)


@inlined
def _half_sine(angle):
    """Return sine and cosine of half an angle, less whole turns of pi."""
    turns = (angle * (0.5 / math.pi) + ROUND) - ROUND
    half = 0.5 * angle - turns * PI_HIGH - turns * PI_LOW
    return half * polynomial(SINE, half * half), polynomial(COSINE, half * half)


@inlined
def sine(angle):
    """Return the sine of an angle of some turns."""
    sine, cosine = _half_sine(angle)
    return 2 * sine * cosine


@inlined
def cosine(angle):
    """Return the cosine of an angle of some turns."""
    sine, _ = _half_sine(angle)
    return 1 - 2 * sine * sine


@inner
def scaled_complementary_error(x):
    """Return exp(x^2) erfc(x), x > -26."""
    if x < ASYMPTOTIC:
        return math.exp(x * x) * math.erfc(x)
    s = 0.5 / (x * x)
    return (1 - s * (1 - 3 * s * (1 - 5 * s * (1 - 7 * s)))) / (x * math.sqrt(math.pi))


@inner
def normal_distribution(u):
    """Return the normal distribution function."""
    return 0.5 * math.erfc(u * -math.sqrt(0.5))


@inner
def log_normal_distribution(u):
    """Return the logarithm of the normal distribution function."""
    if u > -1.0:
        return math.log1p(-0.5 * math.erfc(u * math.sqrt(0.5)))
    return -0.5 * u * u + math.log(0.5 * scaled_complementary_error(-u * math.sqrt(0.5)))


@inlined
def stack(*components):
    """As `elementwise.stack`, of numbers."""
    values = np.empty(len(components))
    for i in range(len(components)):
        values[i] = components[i]
    return values


@inner
def sandwich(matrix, images):
    """As `elementwise.sandwich`, of one pose."""
    side = len(matrix)
    rows = images.reshape(-1, side)
    half = np.empty((len(rows), side))
    np.dot(rows, matrix.T.copy(), half)
    for i in range(0, len(rows), side):
        np.dot(matrix, half[i : i + side], rows[i : i + side])


@inlined
def beside(own, i, image):
    """As `elementwise.beside`."""
    rows, n = own.shape
    for row in range(rows):
        for j in range(n):
            image[row, i * n + j] = own[row, j]


def _on_stack(_typing, count):
    """Return so many numbers on the stack of the function that calls."""

    def generate(context, builder, signature, arguments):
        return builder.alloca(ir.DoubleType(), arguments[0])

    return types.CPointer(types.float64)(types.intp), generate


on_stack: Any = intrinsic(_on_stack)


@njit(inline="always")
def workspace(rows, component, count):
    """As `elementwise.workspace`, of one pose; on the stack, unless it is large."""
    if rows * count > MOST_ON_STACK:
        return np.empty((rows, count))
    return carray(on_stack(rows * count), (rows, count))


@njit(inline="always")
def zeros(rows, columns, component):
    """As `elementwise.zeros`, of one pose; on the stack."""
    matrix = carray(on_stack(rows * columns), (rows, columns))
    for i in range(rows):
        for k in range(columns):
            matrix[i, k] = 0.0
    return matrix


# Of one pose and one reading, where the originals are of many.
one_value = inlined(lambda value: value)
choice = inlined(lambda condition, one, other: one if condition else other)
REPLACED: dict[Any, Any] = {
    elementwise.indices: range,
    elementwise.indices_where: inlined(lambda condition, i: range(i, i + (1 if condition else 0))),
    elementwise.choose: choice,
    elementwise.choose_tuple: choice,
    elementwise.any_of: one_value,
    elementwise.total: one_value,
    elementwise.at_place: inlined(lambda rows, place, i: rows[int(place), i]),
    elementwise.workspace: workspace,
    elementwise.zeros: zeros,
    elementwise.stack: stack,
    elementwise.sandwich: sandwich,
    elementwise.beside: beside,
    np.maximum: inlined(lambda a, b: a if a > b else b),
    np.minimum: inlined(lambda a, b: a if a < b else b),
    np.exp: exponential,
    np.expm1: exponential_less_one,
    np.log: logarithm,
    np.sin: sine,
    np.cos: cosine,
    special.erfcx: scaled_complementary_error,
    special.ndtr: normal_distribution,
    special.log_ndtr: log_normal_distribution,
}
