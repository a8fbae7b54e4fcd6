"""The kernel of `bulk.BulkLight`, for Numba to compile; importing this module imports Numba.

It takes a tile of poses at a time, which stays in the first level of the cache. What every reading
needs is sums and products, which vectorise: no division, no square root, no branch, no call.
"""

import contextlib
import math
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import intrinsic

from uuv_optical_array.core.geometry import PITCH, YAW, Array
from uuv_optical_array.forward.light import MIN_RANGE_M

TILE_POSES, TILE_READINGS = 16, 400
MAX_RANGE_M = 1e100  # whose square is a number

# eta^2 / s by powers of s = sin(eta)^2, highest first: minimax up to 45 deg, right to 7e-17.
SQUARED_ANGLE = (
    2.7124616655916145,
    -10.004857358882923,
    17.571727023989236,
    -19.01318692404218,
    14.169478164381292,
    -7.60441630782109,
    3.077360310267226,
    -0.9071505140312446,
    0.23928802702305582,
    -0.00937123339089781,
    0.03828718456652349,
    0.03928961497271882,
    0.04874835923485211,
    0.061566307856399424,
    0.08126989914313835,
    0.11428571312458523,
    0.17777777779004794,
    0.333333333333282,
    1.0,
)
# `fit_kernel` has these too: change that file with them, or Numba will not compile it again.
EVEN, ODD = SQUARED_ANGLE[::2], SQUARED_ANGLE[1::2]  # powers: two short chains of sums
# sin(x) / x and cos(x) by powers of x^2 up to pi / 2, highest first: minimax, right to 3e-19.
SINE = (
    2.7215660921125597e-15,
    -7.643025738964345e-13,
    1.6058940847832492e-10,
    -2.505210688997513e-08,
    2.7557319211223257e-06,
    -0.00019841269841208638,
    0.008333333333333186,
    -0.16666666666666666,
    1.0,
)
COSINE = (
    -1.51197786600161e-16,
    4.776871733415368e-14,
    -1.1470670142864075e-11,
    2.087675566605353e-09,
    -2.755731920964734e-07,
    2.4801587301492586e-05,
    -0.001388888888888853,
    0.04166666666666666,
    -0.5,
    1.0,
)
# exp by powers up to log(2) / 2, highest first: minimax, right to 3e-18.
EXPONENTIAL = (
    2.5110037605963777e-08,
    2.763263963904103e-07,
    2.755724091857897e-06,
    2.4801485482328494e-05,
    0.00019841269890047113,
    0.0013888888952314775,
    0.008333333333319601,
    0.0416666666664881,
    0.1666666666666668,
    0.5000000000000019,
    1.0,
    1.0,
)
LOG2_HIGH, LOG2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # their sum
PI_HIGH, PI_LOW = 3.1415926534682512, 1.2154201013012384e-10
SMALLEST = -708.0  # logarithm of the smallest number that is not subnormal, nearly
ROUND = 1.5 * 2.0**52  # added to a number it leaves the nearest whole one in the last bits


def _wide_vectors(_typing: Any) -> Any:
    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        with contextlib.suppress(TypeError):  # without it the kernel is slower, and as right
            # llvmlite's own `add` knows no attributes that have a value.
            set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return types.void(), generate


# LLVM keeps to 256 bits on Intel's processors; NumPy's exponential does not. Without AVX-512
# this says nothing.
wide_vectors: Any = intrinsic(_wide_vectors)


def _horner(coefficients: tuple[float, ...], x: float) -> float:
    value = coefficients[0]
    for coefficient in coefficients[1:]:
        value = value * x + coefficient
    return value


def _inverse_root(x: float) -> float:
    """Return 1 / sqrt(x) of a positive number, to an ulp."""
    # Halving and negating the exponent's bits is right to 4 %; the series of (1 - e)^-1/2 mends it.
    bits = np.int64(0x5FE6EB50C7B537A9) - (np.float64(x).view(np.int64) >> np.int64(1))
    root = np.int64(bits).view(np.float64)
    error = 1 - x * root * root
    root += root * error * (0.5 + error * (0.375 + error * (0.3125 + error * 0.2734375)))
    error = 1 - x * root * root
    return root + root * error * (0.5 + error * 0.375)


def _sine_and_cosine(angle: float) -> tuple[float, float]:
    # Of half the angle, less whole turns of pi, which do not change the double angle's.
    turns = (angle * (0.5 / math.pi) + ROUND) - ROUND
    half = 0.5 * angle - turns * PI_HIGH - turns * PI_LOW
    sine = half * horner(SINE, half * half)
    return 2 * sine * horner(COSINE, half * half), 1 - 2 * sine * sine


def _exponential(x: float) -> float:
    """Return exp(x) of a number up to 700, 0 below `SMALLEST`."""
    shifted = x * (1 / math.log(2)) + ROUND
    power = shifted - ROUND
    value = horner(EXPONENTIAL, x - power * LOG2_HIGH - power * LOG2_LOW)
    # Times 2^power: it is in the last bits of `shifted`, and goes to the exponent's.
    bits = np.float64(value).view(np.int64) + (np.float64(shifted).view(np.int64) << np.int64(52))
    return 0.0 if x < SMALLEST else np.int64(bits).view(np.float64)


horner: Any = njit(_horner, inline="always")
inverse_root: Any = njit(_inverse_root, inline="always")
sine_and_cosine: Any = njit(_sine_and_cosine, inline="always")
exponential: Any = njit(_exponential, inline="always")


def write(
    light: Array,
    poses: Array,
    rolls: Array,
    detectors: Array,
    reach_m: float,
    gain: float,
    k_per_m: float,
) -> None:
    """Write the light on `n` detectors at each of `m` poses.

    Parameters
    ----------
    light
        Result, counts, shape ``(m, n)``.
    poses
        Poses of the follower in ``beacon``, m and rad, shape ``(m, 5)``.
    rolls
        Its roll, rad, shape ``(m,)``.
    detectors
        Position, normal times the lamp's power, and their product, shape ``(7, n)``.
    reach_m
        Distance of the farthest detector from ``base_link``, m.
    gain
        Of the squared off-axis angle in the exponent, 1/rad^2, <= 0.
    k_per_m
        Attenuation, 1/m.
    """
    wide_vectors()
    count, n = light.shape
    flat = light.reshape(-1)
    frames = np.empty((15, TILE_POSES))
    here = np.empty((7, TILE_READINGS))
    along, across_squared, facing, range_m, sine_squared, factor, exponent = np.empty(
        (7, TILE_READINGS)
    )
    for low in range(0, n, TILE_READINGS):
        width = min(TILE_READINGS, n - low)
        # Arrays of constant shape, which LLVM can tell apart without tests for every pose.
        here[:, :width] = detectors[:, low : low + width]
        tile = min(TILE_POSES, TILE_READINGS // width) if width == n else 1
        for first in range(0, count, tile):
            size = min(tile, count - first)
            # Of each pose: place and `pose.rotation_matrix`, by rows; the lamp in base_link.
            for i in range(size):
                frames[0, i], frames[4, i], frames[8, i] = (
                    poses[first + i, 0],
                    poses[first + i, 1],
                    poses[first + i, 2],
                )
                frames[12, i], frames[13, i], frames[14, i] = (
                    rolls[first + i],
                    poses[first + i, PITCH],
                    poses[first + i, YAW],
                )
            for i in range(size):
                x, y, z = frames[0, i], frames[4, i], frames[8, i]
                sin_r, cos_r = sine_and_cosine(frames[12, i])
                sin_p, cos_p = sine_and_cosine(frames[13, i])
                sin_y, cos_y = sine_and_cosine(frames[14, i])
                xx, yx, zx = cos_y * cos_p, sin_y * cos_p, -sin_p
                xy, xz = (
                    cos_y * sin_p * sin_r - sin_y * cos_r,
                    cos_y * sin_p * cos_r + sin_y * sin_r,
                )
                yy, yz = (
                    sin_y * sin_p * sin_r + cos_y * cos_r,
                    sin_y * sin_p * cos_r - cos_y * sin_r,
                )
                zy, zz = cos_p * sin_r, cos_p * cos_r
                frames[1, i], frames[2, i], frames[3, i] = xx, xy, xz
                frames[5, i], frames[6, i], frames[7, i] = yx, yy, yz
                frames[9, i], frames[10, i], frames[11, i] = zx, zy, zz
                frames[12, i] = -(xx * x + yx * y + zx * z)
                frames[13, i] = -(xy * x + yy * y + zy * z)
                frames[14, i] = -(xz * x + yz * y + zz * z)
            # Of each reading: its place along the beam and across it; how it faces the lamp.
            for i in range(size):
                x, xx, xy, xz = frames[0, i], frames[1, i], frames[2, i], frames[3, i]
                y, yx, yy, yz = frames[4, i], frames[5, i], frames[6, i], frames[7, i]
                z, zx, zy, zz = frames[8, i], frames[9, i], frames[10, i], frames[11, i]
                lamp_x, lamp_y, lamp_z = frames[12, i], frames[13, i], frames[14, i]
                for j in range(width):
                    a, b, c = here[0, j], here[1, j], here[2, j]
                    along[i * width + j] = -(x + xx * a + xy * b + xz * c)
                    across_y = y + yx * a + yy * b + yz * c
                    across_z = z + zx * a + zy * b + zz * c
                    across_squared[i * width + j] = across_y * across_y + across_z * across_z
                    facing[i * width + j] = max(
                        lamp_x * here[3, j]
                        + lamp_y * here[4, j]
                        + lamp_z * here[5, j]
                        - here[6, j],
                        0.0,
                    )
            # Inverse square, cosine, exponent and exponential, in loops so short that the processor
            # works on several turns at once.
            for k in range(size * width):
                squared = across_squared[k] + along[k] * along[k]
                inverse = inverse_root(squared)
                range_m[k] = squared * inverse
                sine_squared[k] = across_squared[k] * inverse * inverse
                factor[k] = facing[k] * (inverse * inverse * inverse)
            for k in range(size * width):
                s, fourth = sine_squared[k], sine_squared[k] * sine_squared[k]
                eta_squared = s * (horner(EVEN, fourth) + s * horner(ODD, fourth))
                exponent[k] = gain * eta_squared - k_per_m * range_m[k]
            # That holds within 45 deg of the axis, clear of the lamp. Elsewhere, once more.
            for i in range(size):
                x, y, z = frames[0, i], frames[4, i], frames[8, i]
                room_m = -x - math.sqrt(y * y + z * z)
                if math.sqrt(2.0) * (reach_m + MIN_RANGE_M) <= room_m <= MAX_RANGE_M:
                    continue
                for k in range(i * width, (i + 1) * width):
                    far_m = max(math.sqrt(across_squared[k] + along[k] * along[k]), MIN_RANGE_M)
                    eta = math.atan2(math.sqrt(across_squared[k]), along[k])
                    exponent[k] = gain * (eta * eta) - k_per_m * far_m
                    factor[k] = facing[k] / far_m / far_m / far_m
            readings = flat[first * n + low : first * n + low + size * width]
            for k in range(size * width):
                # Half of the exponent, twice: so what is nearly too dim for a number is right too.
                root = exponential(0.5 * exponent[k])
                readings[k] = factor[k] * root * root
