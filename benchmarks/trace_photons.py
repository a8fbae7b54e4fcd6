"""Trace the photons of ``config/flux/``, with which ``uuv_array study transport`` works.

Radiative transfer by Monte Carlo in homogeneous water: a pencil of light is followed from
scattering to scattering. Needs Numba and an hour: ``python benchmarks/trace_photons.py FOLDER``.
"""

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.storage import files
from uuv_optical_array.studies.photon_transport import EDGES, RADII_M, WATERS, Pencil, Phase

INDEX, SLOPE = 1.10, 3.5835  # of Petzold's mean particles: backscatter 1.8 %
ASYMMETRY = 0.924  # mean cosine of Henyey and Greenstein's function
BEYOND_M = 3.0  # from the last sphere outwards, where photons are given up
QUANTILES = 2**14
# A photon of less weight goes on with this probability, and then carries that much more.
LIGHT_WEIGHT, SURVIVAL = 1e-3, 0.1
GRAZING = 0.1  # cosine to the sphere below which it is replaced by half of this
PHOTONS, SEED = 10_000_000, 1


def fournier_forand(half: Array) -> Array:
    """Return the share scattered by less than an angle, by the squared sine of half of it.

    Of particles of a power law of sizes (Fournier and Forand 1994; in the form of Fournier and
    Jonasz 1999), in the choice of Mobley, Sundman and Boss 2002, Appl. Opt. 41, 1035.
    """
    nu = (3 - SLOPE) / 2
    delta = 4 * half / (3 * (INDEX - 1) ** 2)
    delta = np.where(abs(delta - 1) < 1e-6, 1 + 1e-6, delta)  # a removable singularity
    back = 4 / (3 * (INDEX - 1) ** 2)
    share = (1 - delta ** (nu + 1) - (1 - delta**nu) * half) / ((1 - delta) * delta**nu)
    cosine = 1 - 2 * half
    return share + (1 - back**nu) / (8 * (back - 1) * back**nu) * cosine * (1 - cosine**2)


def henyey_greenstein(half: Array) -> Array:
    """Return the same by Henyey and Greenstein 1941."""
    g = ASYMMETRY
    return (1 + g) / (2 * g) * (1 - (1 - g) / np.sqrt((1 - g) ** 2 + 4 * g * half))


PHASES: dict[Phase, Callable[[Array], Array]] = {
    "fournier_forand": fournier_forand,
    "henyey_greenstein": henyey_greenstein,
}


def quantiles(phase: Phase) -> Array:
    """Return squared sines of half the scattering angle at shares from 0 to 1, evenly spaced."""
    half = np.concatenate([np.geomspace(1e-20, 1e-3, 8000), np.linspace(1e-3, 1, 8001)[1:]])
    share, first = np.unique(PHASES[phase](half), return_index=True)
    return np.interp(np.linspace(0, 1, QUANTILES + 1), share / share[-1], half[first])


@njit(nogil=True, error_model="numpy")
def _trace(
    photons: int, a: float, b: float, half: Any, radii: Any, last: float, out: Any, rng: Any
) -> None:
    """Send photons along x and add what crosses the spheres after a scattering, as numbers only.

    `out` is (radial flux, flux away from the pencil, squared weight) by sphere and bin.
    """
    count, bins, cells = out.shape[1], out.shape[2], len(half) - 1
    first, step = radii[0], radii[1] - radii[0]
    forced = -math.expm1(-b * last)  # every photon is scattered before the end, and weighs this
    for _ in range(photons):
        path = -math.log1p(-forced * rng.random()) / b
        weight = forced * math.exp(-a * path)
        x, y, z, dx, dy, dz = path, 0.0, 0.0, 1.0, 0.0, 0.0
        while True:
            place = rng.random() * cells
            cell = int(place)
            t = half[cell] + (place - cell) * (half[cell + 1] - half[cell])
            sine, turn = 2 * math.sqrt(t * (1 - t)), 2 * math.pi * rng.random()
            u, v, w = sine * math.cos(turn), sine * math.sin(turn), 1 - 2 * t
            # Two axes across the direction (Duff et al. 2017).
            sign = 1.0 if dz >= 0 else -1.0
            k = -1 / (sign + dz)
            m = dx * dy * k
            dx, dy, dz = (
                u * (1 + sign * dx * dx * k) + v * m + w * dx,
                u * sign * m + v * (sign + dy * dy * k) + w * dy,
                -u * sign * dx - v * dy + w * dz,
            )
            norm = 1 / math.sqrt(dx * dx + dy * dy + dz * dz)
            dx, dy, dz = dx * norm, dy * norm, dz * norm
            path = -math.log1p(-rng.random()) / b
            start = x * dx + y * dy + z * dz
            end = start + path
            nearest = max(x * x + y * y + z * z - start * start, 0.0)
            for leg in (-1.0, 1.0):  # inwards, then outwards
                low, high = (max(start, 0.0), end) if leg > 0 else (min(end, 0.0), start)
                if leg * (high - low) <= 0:
                    continue
                inner, outer = math.sqrt(nearest + low * low), math.sqrt(nearest + high * high)
                for i in range(
                    max(0, math.ceil((inner - first) / step)),
                    min(count - 1, math.floor((outer - first) / step)) + 1,
                ):
                    r = first + step * i
                    along = leg * math.sqrt(max(r * r - nearest, 0.0))
                    far = along - start
                    cosine = (x + far * dx) / r
                    across = math.hypot(y + far * dy, z + far * dz) / r
                    k = int(bins * math.sqrt(math.atan2(across, cosine) / math.pi))
                    arrives = weight * math.exp(-a * far)
                    facing = along / r
                    steep = abs(facing) if abs(facing) > GRAZING else GRAZING / 2
                    out[0, i, k] += leg * arrives
                    out[1, i, k] += arrives * (cosine * facing - dx) / (max(across, 1e-9) * steep)
                    out[2, i, k] += arrives * arrives
            x, y, z = x + path * dx, y + path * dy, z + path * dz
            weight *= math.exp(-a * path)
            if x * x + y * y + z * z > last * last:
                break
            if weight < LIGHT_WEIGHT:
                if rng.random() > SURVIVAL:
                    break
                weight /= SURVIVAL


def trace(a: float, b: float, phase: Phase, photons: int, rng: np.random.Generator) -> Pencil:
    """Trace photons in water of absorption and scattering a and b, 1/m."""
    out = np.zeros((3, len(RADII_M), len(EDGES) - 1))
    last = float(RADII_M[-1] + BEYOND_M)
    a, b = float(a), float(b)
    _trace(photons, a, b, quantiles(phase), RADII_M, last, out, rng)
    return Pencil(a, b, phase, photons, *(out / photons))


def save(pencil: Pencil, path: Path) -> None:
    """Write what `shipped_pencil` reads."""
    values: dict[str, Any] = {
        name: value.astype(np.float32) if isinstance(value, np.ndarray) else value
        for name, value in vars(pencil).items()
    }
    with files.whole_file(path) as scratch, scratch.open("wb") as file:
        np.savez_compressed(file, **values)


def make(folder: Path, photons: int = PHOTONS) -> None:
    """Trace the pencil of each water and phase function into files of a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for phase in PHASES:
        for water, (a, b) in WATERS.items():
            path = folder / f"{water}_{phase}.npz"
            save(trace(a, b, phase, photons, np.random.default_rng(SEED)), path)
            print(path, flush=True)


if __name__ == "__main__":
    make(Path(sys.argv[1]))
