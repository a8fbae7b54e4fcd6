"""Radiative transfer by Monte Carlo: the light of a lamp in homogeneous water, photon by photon.

Water looks the same in all directions, so one pencil of light from the lamp's place is traced: the
light of any lamp is that of its pencils, weighted by its intensity. What was never scattered is
added in closed form.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from scipy.interpolate import RectBivariateSpline

from uuv_optical_array.core.extras import needs
from uuv_optical_array.core.geometry import Array, lamp_in_body
from uuv_optical_array.core.storage import files
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.effects.waters import PETZOLD_PER_M
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.optics import detect
from uuv_optical_array.forward.scene import Scene

Phase: TypeAlias = Literal["fournier_forand", "henyey_greenstein"]

INDEX, SLOPE = 1.10, 3.5835  # of Petzold's mean particles: backscatter 1.8 %
ASYMMETRY = 0.924  # mean cosine of Henyey and Greenstein's function
WATERS = {name.removeprefix("petzold_"): sea for name, sea in PETZOLD_PER_M.items()}
RADII_M: Array = np.linspace(1, 10, 19, dtype=float)  # of the spheres about the lamp
EDGES: Array = np.pi * np.square(np.linspace(0, 1, 161, dtype=float))  # bins off the pencil, rad
BEYOND_M = 3.0  # from the last sphere outwards, where photons are given up
QUANTILES = 2**14
# A photon of less weight goes on with this probability, and then carries that much more.
LIGHT_WEIGHT, SURVIVAL = 1e-3, 0.1
GRAZING = 0.1  # cosine to the sphere below which it is replaced by half of this
# Where a lamp's flux is summed, rad.
OFF_AXIS: Array = np.radians(np.linspace(0, 60, 121, dtype=float))
TURNS = (np.arange(128) + 0.5) * math.pi / 128  # about the ray, over which a lamp is averaged


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


@cache
def _compiled() -> Any:
    return needs("fast", "numba").njit(nogil=True, error_model="numpy")(_trace)


@dataclass(frozen=True)
class Pencil:
    """Light of a pencil in water that has been scattered, through spheres about its source.

    - absorption_per_m, scattering_per_m: of the water, >= 0 and > 0, 1/m.
    - phase: name of the phase function.
    - photons: how many were traced.
    - radial, away: net flux outwards and away from the pencil, of one unit sent, through the bins
      between `EDGES` of the spheres of `RADII_M`, shape ``(spheres, bins)``.
    - squares: as `radial`, of the photons' squared weights, for the error by chance.
    """

    absorption_per_m: float
    scattering_per_m: float
    phase: Phase
    photons: int
    radial: Array
    away: Array
    squares: Array

    def save(self, path: Path) -> None:
        """Write it, whole or not at all."""
        values: dict[str, Any] = {
            name: value.astype(np.float32) if isinstance(value, np.ndarray) else value
            for name, value in vars(self).items()
        }
        with files.whole_file(path) as scratch, scratch.open("wb") as file:
            np.savez_compressed(file, **values)


def load_pencil(path: Path) -> Pencil:
    """Read what `Pencil.save` wrote."""
    with np.load(path) as kept:
        values = {name: kept[name] for name in kept.files}
    return Pencil(**{k: v.astype(float) if v.ndim else v.item() for k, v in values.items()})


def shipped_pencil(water: str, phase: Phase = "fournier_forand") -> Pencil:
    """Return the pencil that the package has of one of `WATERS`."""
    return load_pencil(files.shared_file(f"config/flux/{water}_{phase}.npz"))


def trace(a: float, b: float, phase: Phase, photons: int, rng: np.random.Generator) -> Pencil:
    """Trace photons in water of absorption and scattering a and b, 1/m.

    A ValueError says that Numba is not installed.
    """
    out = np.zeros((3, len(RADII_M), len(EDGES) - 1))
    last = float(RADII_M[-1] + BEYOND_M)
    a, b = float(a), float(b)
    _compiled()(photons, a, b, quantiles(phase), RADII_M, last, out, rng)
    return Pencil(a, b, phase, photons, *(out / photons))


class Lamp:
    """Light of a Gaussian lamp in the water of a `Pencil`: 1 at 1 m on the axis without water.

    `flux` is that of `radial` and `away` (from the lamp's axis) times the squared radius, scattered
    alone, at `RADII_M` and `OFF_AXIS`; `error` is the standard error of the former.
    """

    def __init__(self, pencil: Pencil, beam_sigma_rad: float) -> None:
        self.pencil, self.sigma = pencil, beam_sigma_rad
        middle = np.sqrt((EDGES[1:] ** 2 + EDGES[:-1] ** 2) / 2)
        # Pencils that pass a place at an angle stand around the ray to it, turned about it.
        eta, off, turn = OFF_AXIS[:, None, None], middle[:, None], TURNS
        cosine = np.cos(eta) * np.cos(off) + np.sin(eta) * np.sin(off) * np.cos(turn)
        intensity = self.intensity(np.arccos(np.clip(cosine, -1, 1)))
        weight, turned = intensity.mean(-1), (intensity * np.cos(turn)).mean(-1)
        self.flux = np.stack([pencil.radial @ weight.T, pencil.away @ turned.T])
        # A photon crosses a sphere once, but for those few that turn back.
        square = pencil.squares @ np.square(weight).T - self.flux[0] ** 2
        self.error = np.sqrt(np.maximum(square, 0.0) / pencil.photons)
        self._splines = [RectBivariateSpline(RADII_M, OFF_AXIS, part) for part in self.flux]

    def intensity(self, eta: Array) -> Array:
        """Return that of the lamp at angles off its axis, rad."""
        return np.exp(-0.5 * np.square(eta / self.sigma))

    def vector(self, range_m: Array, eta: Array) -> tuple[Array, Array]:
        """Return the net flux outwards and away from the axis, within the spheres."""
        if range_m.min() < RADII_M[0] or range_m.max() > RADII_M[-1] or eta.max() > OFF_AXIS[-1]:
            raise ValueError(
                f"range: {range_m.min():.3g} to {range_m.max():.3g} m, up to "
                f"{np.degrees(eta.max()):.3g} deg off the axis; photons are known from "
                f"{RADII_M[0]:g} to {RADII_M[-1]:g} m and up to {np.degrees(OFF_AXIS[-1]):g} deg"
            )
        radial, away = (spline.ev(range_m, eta) for spline in self._splines)
        water = self.pencil
        extinction = water.absorption_per_m + water.scattering_per_m
        radial = radial + np.exp(-extinction * range_m) * self.intensity(eta)
        return radial / range_m**2, away / range_m**2

    def images(self, array: DetectorArray, poses: Array) -> Array:
        """Return the light on an array at poses ``(m, 5)``, m and rad, shape ``(m, side, side)``.

        It is the net flux through the face of each detector; 0 where that comes from behind.
        """
        x, y, z, pitch, yaw = np.asarray(poses, float).T[..., None]
        lamp = np.moveaxis(np.array(lamp_in_body(x, y, z, pitch, yaw, 0.0)), 0, -1)
        ray = array.positions - lamp[..., :3]
        range_m = np.linalg.norm(ray, axis=-1)
        ray /= range_m[..., None]
        axis = np.broadcast_to(lamp[..., 3:], ray.shape)
        along = (ray * axis).sum(-1)
        across = ray - along[..., None] * axis
        sine = np.linalg.norm(across, axis=-1)
        radial, away = self.vector(range_m, np.arctan2(sine, along))
        # Across the ray, away from the axis.
        side = (along / np.maximum(sine, 1e-12))[..., None] * across - sine[..., None] * axis
        flux = radial[..., None] * ray + away[..., None] * side
        light = np.maximum(-(flux * array.normals).sum(-1), 0.0)
        return light.reshape(len(light), array.side, array.side)


class PhotonSea:
    """A scene in the water of a pencil, where its lamp gives its reference reading.

    `model` reads the light. Lamp and array are the scene's, and what acts on the array, but no
    effect between the two.
    """

    def __init__(self, scene: Scene, pencil: Pencil) -> None:
        self.model = ForwardModel(scene)
        self._lamp = Lamp(pencil, np.radians(scene.lamp.beam_sigma_deg))
        self._optics, self._power = self.model.optics(), 1.0
        aligned = np.array([[-scene.lamp.reference_range_m, 0.0, 0.0, 0.0, 0.0]])
        self._power = scene.lamp.reference_counts / self.light(aligned).max()

    def light(self, poses: Array) -> Array:
        """Return the light at poses ``(m, 5)``, counts, shape ``(m, side, side)``."""
        images = self._power * self._lamp.images(self.model.array, poses)
        flat = images.reshape(1, len(poses), -1)
        detect(self._optics, np.zeros((0, len(poses), 1)), flat)
        return flat.reshape(images.shape)
