"""Light on very many poses at once: blocks that stay in the cache, compiled where that pays.

`bulk_kernel`, which Numba compiles, and NumPy both cover inverse square, Gaussian beam, Lambert's
cosine and attenuation, and agree with `light.trace` and `light.irradiance` to rounding. Numba is
imported when it is first used.
"""

import importlib.util
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from uuv_optical_array.core.geometry import PITCH, YAW, Array, rotation_matrix
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.light import MIN_RANGE_M

BLOCK_READINGS = 51_200  # whose five arrays stay in the second level of the cache
# To load Numba and a kernel that was compiled before takes as long as it saves here.
WORTH_READINGS = 20_000_000


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
    """Return `bulk_kernel.write`, compiled; on the disk of a user who may write there it is kept.

    Raises
    ------
    ValueError
        Where Numba is not installed, or not for this NumPy.
    """
    try:
        from numba import float64, njit, types, void

        from uuv_optical_array.forward.light_batch_kernel import write
    except ImportError as error:
        raise ValueError(f"compiled: {error}; install Numba: pip install -e '.[fast]'") from None
    matrix, poses = float64[:, ::1], types.Array(float64, 2, "A", readonly=True)
    rolls = types.Array(float64, 1, "A", readonly=True)
    signature = void(matrix, poses, rolls, matrix, float64, float64, float64)
    options: dict[str, Any] = {"fastmath": {"contract"}, "error_model": "numpy", "nogil": True}
    try:
        return njit(signature, cache=True, **options)(write)
    except (OSError, RuntimeError):  # no folder to keep it in
        return njit(signature, **options)(write)


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
                settings = self._detectors, self._reach_m, self._gain, self._k_per_m
                self._kernel(light, poses, rolls, *settings)

    def _prepared(self, poses: Array, rolls: Array) -> tuple[Array, Array]:
        """Return exponents and factors of the light, shape ``(n, m)``, which NumPy is fast in."""
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
