"""Light on very many poses at once: blocks that stay in the cache, compiled where that pays.

Each block is worked out twofold, an exponent and a factor for every reading, by Numba's kernel or
by NumPy; then NumPy's own exponential, which is vectorised, joins them. Both cover inverse square,
Gaussian beam, Lambert's cosine and attenuation, and agree with `light.trace` and `light.irradiance`
to rounding. Numba is imported when it is first used.
"""

import importlib.util
import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from uuv_optical_array.array import DetectorArray
from uuv_optical_array.light import MIN_RANGE_M
from uuv_optical_array.pose import PITCH, YAW, Array, rotation_matrix

BLOCK_READINGS = 51_200  # whose five arrays stay in the second level of the cache
# To load Numba and a kernel that was compiled before takes as long as it saves here.
WORTH_READINGS = 20_000_000

# eta^2 / v by powers of the versine v = 1 - cos(eta), highest first; eta^2 is analytic in v. The
# polynomial through 12 Chebyshev nodes is right to 1e-15 up to 45 deg.
_SQUARED_ANGLE = (
    4.894417881090888e-05,
    2.256598717043553e-05,
    0.00012319845659466692,
    0.0002563201489185122,
    0.0006223205137423159,
    0.0015221944955091562,
    0.003848011668809029,
    0.010158729742292509,
    0.028571428584472272,
    0.08888888888867834,
    0.33333333333333465,
    2.0,
)


def installed() -> bool:
    """Say whether Numba is there, without importing it."""
    return importlib.util.find_spec("numba") is not None


def worthwhile(readings: int) -> bool:
    """Say whether so many readings repay loading the kernel, and load it if so."""
    if readings < WORTH_READINGS or not installed():
        return False
    try:
        kernel()
    except ValueError:
        return False
    return True


@cache
def kernel() -> Callable[..., None]:
    """Return `prepare`, compiled; on the disk of a user who may write there it is kept.

    Raises
    ------
    ValueError
        Where Numba is not installed, or not for this NumPy.
    """
    try:
        from numba import njit
    except ImportError as error:
        raise ValueError(f"compiled: {error}; install Numba: pip install -e '.[fast]'") from None
    matrix, number = "float64[:, ::1]", "float64"
    signature = ", ".join([matrix] * 2 + [number] * 3 + [matrix] * 2)
    options: dict[str, Any] = {"fastmath": {"contract"}, "error_model": "numpy", "nogil": True}
    try:
        return njit(f"void({signature})", cache=True, **options)(prepare)
    except (OSError, RuntimeError):  # no folder to keep it in
        return njit(f"void({signature})", **options)(prepare)


class BulkLight:
    """Lamp, water and array, set up for blocks of poses.

    Parameters
    ----------
    array
        Detector array of n detectors.
    beam_sigma_rad, power
        As in `light.irradiance`.
    k_per_m
        Attenuation along the path, 1/m, >= 0.
    compiled
        Whether Numba's kernel does the work.

    Attributes
    ----------
    block : int
        Poses that are best written at a time.

    Raises
    ------
    ValueError
        As `kernel`.
    """

    def __init__(
        self,
        array: DetectorArray,
        beam_sigma_rad: float,
        power: float,
        k_per_m: float,
        compiled: bool,
    ) -> None:
        count = len(array.positions)
        self.block = max(1, BLOCK_READINGS // count)
        self._gain, self._power, self._k_per_m = -0.5 / beam_sigma_rad**2, power, k_per_m
        # Position, normal times power, and their product, which the lamp's place is compared with.
        self._detectors = np.empty((7, count))
        self._detectors[:3] = array.positions.T
        self._detectors[3:6] = power * array.normals.T
        self._detectors[6] = power * (array.positions * array.normals).sum(axis=1)
        self._reach_m = float(np.linalg.norm(array.positions, axis=1).max())
        self._kernel = kernel() if compiled else None

    def write(self, light: Array, poses: Array, rolls: Array) -> None:
        """Write the light at each pose.

        Parameters
        ----------
        light
            Result, counts, shape ``(m, n)``, contiguous.
        poses
            Poses of the follower in ``beacon``, m and rad, shape ``(m, 5)``.
        rolls
            Its roll, rad, shape ``(m,)``.
        """
        with np.errstate(under="ignore"):
            if self._kernel is None:
                exponents, factors = self._prepared(poses, rolls)
                np.multiply(factors.T, np.exp(exponents, out=exponents).T, out=light)
            else:
                places = np.empty((6, len(poses)))
                places[:3] = poses[:, :3].T
                places[3:] = rolls, poses[:, PITCH], poses[:, YAW]
                places[3:] *= 0.5
                np.tan(places[3:], out=places[3:])
                exponents = np.empty(light.shape)
                settings = self._detectors, self._reach_m, self._gain, self._k_per_m
                self._kernel(places, *settings, exponents, light)
                light *= np.exp(exponents, out=exponents)

    def _prepared(self, poses: Array, rolls: Array) -> tuple[Array, Array]:
        """Return what `prepare` writes, by NumPy and in shape ``(n, m)``, which it is fast in."""
        detectors, count = self._detectors, len(poses)
        turn = np.empty((3, 4, count))  # by rows: axes of base_link and its place, in beacon
        turn[:, :3] = np.moveaxis(rotation_matrix(poses[:, PITCH], poses[:, YAW], rolls), 0, -1)
        turn[:, 3] = poses[:, :3].T
        lamp = np.full((4, count), -1.0)
        lamp[:3] = -(turn[:, :3] * turn[:, 3:]).sum(axis=0)
        at = np.ones((detectors.shape[1], 4))
        at[:, :3] = detectors[:3].T
        exponents, factors, range_m, across = np.empty((4, len(at), count))
        # In place throughout: a new array for each step would cost more than the step.
        np.matmul(at, turn[1], out=across)
        across *= across
        np.matmul(at, turn[2], out=range_m)
        range_m *= range_m
        across += range_m
        along = np.matmul(-at, turn[0], out=exponents)
        np.multiply(along, along, out=range_m)
        range_m += across
        np.maximum(np.sqrt(range_m, out=range_m), MIN_RANGE_M, out=range_m)
        eta = np.arctan2(np.sqrt(across, out=across), along, out=exponents)
        eta *= eta
        eta *= self._gain
        np.matmul(detectors[3:].T, lamp, out=factors)
        factors /= range_m
        np.clip(factors, 0.0, self._power, out=factors)  # a cosine is at most 1
        factors /= range_m
        factors /= range_m
        range_m *= self._k_per_m
        exponents -= range_m
        return exponents, factors


def prepare(
    places: Array,
    detectors: Array,
    reach_m: float,
    gain: float,
    k_per_m: float,
    exponents: Array,
    factors: Array,
) -> None:
    """Work out exponents and factors, `n` detectors at each of `m` poses; Numba compiles this.

    Parameters
    ----------
    places
        x, y and z in m, and the tangents of half the roll, pitch and yaw, each of which gives sine
        and cosine; shape ``(6, m)``.
    detectors
        Position, normal times the lamp's power, and their product, shape ``(7, n)``.
    reach_m
        Distance of the farthest detector from ``base_link``, m.
    gain
        Of the squared off-axis angle in the exponent, 1/rad^2, <= 0.
    k_per_m
        Attenuation, 1/m.
    exponents, factors
        Results, shape ``(m, n)``: the light is ``exp(exponent) factor``.
    """
    for i in range(places.shape[1]):
        x, y, z = places[0, i], places[1, i], places[2, i]
        r, p, w = places[3, i], places[4, i], places[5, i]
        share_r, share_p, share_w = 1 / (1 + r * r), 1 / (1 + p * p), 1 / (1 + w * w)
        sin_r, cos_r = 2 * r * share_r, (1 - r * r) * share_r
        sin_p, cos_p = 2 * p * share_p, (1 - p * p) * share_p
        sin_y, cos_y = 2 * w * share_w, (1 - w * w) * share_w
        # As `pose.rotation_matrix`.
        xx, yx, zx = cos_y * cos_p, sin_y * cos_p, -sin_p
        xy, xz = cos_y * sin_p * sin_r - sin_y * cos_r, cos_y * sin_p * cos_r + sin_y * sin_r
        yy, yz = sin_y * sin_p * sin_r + cos_y * cos_r, sin_y * sin_p * cos_r - cos_y * sin_r
        zy, zz = cos_p * sin_r, cos_p * cos_r
        lamp_x = -(xx * x + yx * y + zx * z)
        lamp_y = -(xy * x + yy * y + zy * z)
        lamp_z = -(xz * x + yz * y + zz * z)
        # All detectors lie in a cone of 45 deg about the axis, and clear of its tip.
        near_axis = -x - math.sqrt(y * y + z * z) >= math.sqrt(2.0) * (reach_m + MIN_RANGE_M)
        if near_axis:
            for j in range(detectors.shape[1]):
                a, b, c = detectors[0, j], detectors[1, j], detectors[2, j]
                along = -(x + xx * a + xy * b + xz * c)
                across_y = y + yx * a + yy * b + yz * c
                across_z = z + zx * a + zy * b + zz * c
                squared = across_y * across_y + across_z * across_z
                range_m = math.sqrt(squared + along * along)
                # One division gives both 1 / range and the versine.
                shared = 1 / (range_m * (range_m + along))
                inverse = (range_m + along) * shared
                versine = squared * shared
                eta_squared = _SQUARED_ANGLE[0]
                for coefficient in _SQUARED_ANGLE[1:]:
                    eta_squared = eta_squared * versine + coefficient
                facing = (
                    lamp_x * detectors[3, j]
                    + lamp_y * detectors[4, j]
                    + lamp_z * detectors[5, j]
                    - detectors[6, j]
                )
                exponents[i, j] = gain * (eta_squared * versine) - k_per_m * range_m
                factors[i, j] = inverse * inverse * inverse * max(facing, 0.0)
        else:
            for j in range(detectors.shape[1]):
                a, b, c = detectors[0, j], detectors[1, j], detectors[2, j]
                along = -(x + xx * a + xy * b + xz * c)
                across_y = y + yx * a + yy * b + yz * c
                across_z = z + zx * a + zy * b + zz * c
                squared = across_y * across_y + across_z * across_z
                range_m = max(math.sqrt(squared + along * along), MIN_RANGE_M)
                eta = math.atan2(math.sqrt(squared), along)
                facing = (
                    lamp_x * detectors[3, j]
                    + lamp_y * detectors[4, j]
                    + lamp_z * detectors[5, j]
                    - detectors[6, j]
                )
                exponents[i, j] = gain * (eta * eta) - k_per_m * range_m
                factors[i, j] = max(facing, 0.0) / range_m / range_m / range_m
