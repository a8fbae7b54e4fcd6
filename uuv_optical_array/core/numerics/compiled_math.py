"""What functions are in compiled code, for Numba.

A plain function of this package that a compiled one calls is compiled itself. The helpers of
`elementwise`, which act on many poses and readings in NumPy, are those of one pose and one reading.
"""

import math
from functools import partial
from types import FunctionType
from typing import Any

import numpy as np
from numba import njit, types
from numba.core import cgutils
from numba.core.registry import cpu_target
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    infer_getattr,
    intrinsic,
    lower_getattr_generic,
    models,
    overload,
    register_model,
    typeof_impl,
)
from scipy import special

from uuv_optical_array.core.numerics import compilation, elementwise

# exp by powers up to log(2) / 2, highest first: minimax, right to 3e-18.
EXPONENTIAL = (
    *(2.5110037605963777e-08, 2.763263963904103e-07, 2.755724091857897e-06),
    *(2.4801485482328494e-05, 0.00019841269890047113, 0.0013888888952314775),
    *(0.008333333333319601, 0.0416666666664881, 0.1666666666666668),
    *(0.5000000000000019, 1.0, 1.0),
)
# sin(x) / x by powers of x^2 up to a quarter of a turn, highest first: minimax, right to 3e-19.
SINE = (
    *(2.7204797413775634e-15, -7.642917869710802e-13, 1.6058936492839012e-10),
    *(-2.5052106798323757e-08, 2.755731921015326e-06, -0.00019841269841201843),
    *(0.008333333333333165, -0.16666666666666666, 1.0),
)
PI_HIGH, PI_LOW = math.pi, 1.2246467991473532e-16  # their sum
LOG2_HIGH, LOG2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # their sum
SMALLEST = -708.0  # logarithm of the smallest number that is not subnormal, nearly
ROUND = 1.5 * 2.0**52  # added to a number it leaves the nearest whole one in the last bits
LARGE = 8  # members of a tuple, up to which it is still handed over by value
ASYMPTOTIC = 25.0  # from here a series of the scaled complementary error function is exact

# Optimised by themselves, else a frame takes up to 1.2 times as long.
within = partial(njit, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
inner, inlined = within(), within(forceinline=True, fastmath={"contract"})


@typeof_impl.register(FunctionType)
def type_of_function(function, _context):
    """Return Numba's type of a plain function that compiled code names; ``None``: it has none."""
    if function in INSTEAD:
        return cpu_target.typing_context.resolve_value_type(INSTEAD[function])
    if compilation.is_source(function):
        return types.Dispatcher(compilation.for_callers(function))
    return None


@inlined
def power_and_rest(x):
    """Return the whole number of powers of two in exp(x), in the last bits, and what is left."""
    shifted = x * (1 / math.log(2)) + ROUND
    power = shifted - ROUND
    return np.float64(shifted).view(np.int64), x - power * LOG2_HIGH - power * LOG2_LOW


@inlined
def polynomial(coefficients, x):
    """Evaluate a polynomial by Horner's rule, highest power first."""
    value = coefficients[0]
    for coefficient in coefficients[1:]:
        value = value * x + coefficient
    return value


# Of a loop with these two the compiler makes vectors, and none of one that calls the library:
# without them alone a frame takes 1.09 times as long, and 1.23 times without what else vectors
# need (`compilation.FASTMATH`).
@inlined
def exponential(x):
    """Return exp(x) of a number up to 700, 0 below `SMALLEST`."""
    power, rest = power_and_rest(x)
    value = np.float64(polynomial(EXPONENTIAL, rest)).view(np.int64)
    value = np.int64(value + (power << np.int64(52))).view(np.float64)
    return 0.0 if x < SMALLEST else value


@inlined
def exponential_less_one(x):
    """Return exp(x) - 1 of a number up to 700."""
    power, rest = power_and_rest(x)
    scale = np.int64((power + np.int64(1023)) << np.int64(52)).view(np.float64)
    value = scale * (rest * polynomial(EXPONENTIAL[:-1], rest)) + (scale - 1)
    return -1.0 if x < SMALLEST else value


@inlined
def sine(x):
    """Return sin(x), as `elementwise.sin`."""
    shifted = x * (1 / math.pi) + ROUND
    half_turns = shifted - ROUND
    rest = x - half_turns * PI_HIGH - half_turns * PI_LOW
    value = rest * polynomial(SINE, rest * rest)
    odd = np.float64(shifted).view(np.int64) << np.int64(63)
    return np.int64(np.float64(value).view(np.int64) ^ odd).view(np.float64)


@inlined
def cosine(x):
    """Return cos(x), as `elementwise.cos`."""
    return sine(x + math.pi / 2)


@inner
def scaled_complementary_error(x):
    """Return exp(x^2) erfc(x), x > -26."""
    if x < ASYMPTOTIC:
        return math.exp(x * x) * math.erfc(x)
    s = 0.5 / (x * x)
    return (1 - s * (1 - 3 * s * (1 - 5 * s * (1 - 7 * s)))) / (x * math.sqrt(math.pi))


# Numba has none of SciPy's functions.
@overload(special.erfcx)
def _erfcx(x):
    return lambda x: scaled_complementary_error(x)


@overload(special.ndtr)
def _ndtr(u):
    return lambda u: 0.5 * math.erfc(u * -math.sqrt(0.5))


@overload(special.log_ndtr)
def _log_ndtr(u):
    def logarithm(u):
        if u > -1.0:
            return math.log1p(-0.5 * math.erfc(u * math.sqrt(0.5)))
        return -0.5 * u * u + math.log(0.5 * scaled_complementary_error(-u * math.sqrt(0.5)))

    return logarithm


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


@inner
def partition(values, n):
    """As `elementwise.partition` (C. Hoare, 1961, Comm. ACM 4, 321)."""
    first, last = 0, len(values) - 1
    while first < last:
        pivot, i, k = values[n], first, last
        while i <= k:
            while values[i] < pivot:
                i += 1
            while values[k] > pivot:
                k -= 1
            if i <= k:
                values[i], values[k] = values[k], values[i]
                i, k = i + 1, k - 1
        if k < n:
            first = i
        if i > n:
            last = k


@inlined
def beside(own, i, image):
    """As `elementwise.beside`."""
    rows, n = own.shape
    for row in range(rows):
        for j in range(n):
            image[row, i * n + j] = own[row, j]


class Borrowed(types.CPointer):
    """The address of a named tuple, whose members are taken from there where they are named.

    By value each array is nine numbers, in every call: with that alone a frame takes 1.00 to 1.15
    times as long, and where references to the arrays are counted, too, 1.12 times that.
    """

    def member(self, name):
        """Return place and type of a member; of a large tuple in the tuple its address."""
        place = self.dtype.fields.index(name)
        kind = self.dtype.types[place]
        large = isinstance(kind, types.BaseTuple) and len(kind) > LARGE
        return place, Borrowed(kind) if large else kind


register_model(Borrowed)(models.PointerModel)


@infer_getattr
class _Members(AttributeTemplate):
    key = Borrowed

    def generic_resolve(self, kind, name):
        return kind.member(name)[1]


@lower_getattr_generic(Borrowed)
def _member(context, builder, kind, address, name):
    place, member = kind.member(name)
    address = cgutils.gep_inbounds(builder, address, 0, place)
    if isinstance(member, Borrowed):
        return address
    return uncounted(context, builder, member, context.unpack_value(builder, member, address))


def uncounted(context, builder, kind, value):
    """Return arrays without what counts references to them."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo, array.parent = array.meminfo.type(None), array.parent.type(None)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        for i, each in enumerate(kind.types):
            part = uncounted(context, builder, each, builder.extract_value(value, i))
            value = builder.insert_value(value, part, i)
    return value


@intrinsic
def borrowed(_typing, value):
    """As `elementwise.borrowed`: the address of the same arrays."""
    if isinstance(value, Borrowed):
        return value(value), lambda _context, _builder, _signature, arguments: arguments[0]

    def build(context, builder, signature, arguments):
        place = cgutils.alloca_once(builder, context.get_data_type(value))
        context.pack_value(builder, value, arguments[0], place)
        return place

    return Borrowed(value)(value), build


one_value = inlined(lambda value: value)
choice = inlined(lambda condition, one, other: one if condition else other)
INSTEAD: dict[Any, Any] = {
    elementwise.indices: range,
    elementwise.indices_where: inlined(lambda condition, i: range(i, i + (1 if condition else 0))),
    elementwise.choose: choice,
    elementwise.choose_tuple: choice,
    elementwise.any_of: one_value,
    elementwise.total: one_value,
    elementwise.at_place: inlined(lambda rows, place, i: rows[int(place), i]),
    elementwise.workspace: inlined(lambda rows, component, count: np.empty((rows, count))),
    elementwise.zeros: inlined(lambda rows, columns, component: np.zeros((rows, columns))),
    elementwise.borrowed: borrowed,
    elementwise.stack: stack,
    elementwise.sandwich: sandwich,
    elementwise.partition: partition,
    elementwise.beside: beside,
    elementwise.exp: exponential,
    elementwise.expm1: exponential_less_one,
    elementwise.sin: sine,
    elementwise.cos: cosine,
    # One instruction each, where those of NumPy take four.
    elementwise.maximum: inlined(lambda x, low: low if low > x else x),
    elementwise.minimum: inlined(lambda x, high: high if high < x else x),
}
