"""The light of a lamp in homogeneous water from photons that were traced one by one.

Water looks the same in all directions, so one pencil was traced (``benchmarks/trace_photons.py``):
a lamp's light is that of pencils weighted by its intensity. Unscattered light has a closed form.
"""

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from scipy.interpolate import RectBivariateSpline

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.storage import files
from uuv_optical_array.forward.effects.waters import PETZOLD_PER_M
from uuv_optical_array.forward.lamp.beam import UNIT, gaussians_of, radiance
from uuv_optical_array.forward.light import AXIAL, COSINE, HALF_SQUARE, RANGE
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.optics import detect
from uuv_optical_array.forward.scene import Scene

Phase: TypeAlias = Literal["fournier_forand", "henyey_greenstein"]

WATERS = {name.removeprefix("petzold_"): sea for name, sea in PETZOLD_PER_M.items()}
RADII_M: Array = np.linspace(1, 10, 19, dtype=float)  # of the spheres about the lamp
EDGES: Array = np.pi * np.square(np.linspace(0, 1, 161, dtype=float))  # bins off the pencil, rad
# Where a lamp's flux is summed, rad.
OFF_AXIS: Array = np.radians(np.linspace(0, 60, 121, dtype=float))
TURNS = (np.arange(128) + 0.5) * math.pi / 128  # about the ray, over which a lamp is averaged


@dataclass(frozen=True)
class Pencil:
    """Scattered light of a pencil through the bins between `EDGES` of the spheres of `RADII_M`."""

    absorption_per_m: float  # of the water, >= 0
    scattering_per_m: float  # > 0
    phase: Phase
    photons: int  # that were traced
    radial: Array  # net flux outwards, of one unit sent, (spheres, bins)
    away: Array  # and away from the pencil
    squares: Array  # as `radial`, of the photons' squared weights, for the error by chance


def shipped_pencil(water: str, phase: Phase = "fournier_forand") -> Pencil:
    """Return the pencil that the package has of one of `WATERS`."""
    with np.load(files.shared_file(f"config/flux/{water}_{phase}.npz")) as kept:
        values = {name: kept[name] for name in kept.files}
    return Pencil(**{k: v.astype(float) if v.ndim else v.item() for k, v in values.items()})


class Lamp:
    """Light of a lamp in the water of a `Pencil`: 1 at 1 m on the axis without water.

    Its beam is a Gaussian, or a sum as of `beam.gaussians_of`.

    `flux` is that of `radial` and `away` (from the lamp's axis) times the squared radius, scattered
    alone, at `RADII_M` and `OFF_AXIS`; `error` is the standard error of the former.
    """

    def __init__(self, pencil: Pencil, beam_sigma_rad: float, gaussians: Array = UNIT) -> None:
        self.pencil, self.sigma, self.gaussians = pencil, beam_sigma_rad, gaussians
        middle = np.sqrt((EDGES[1:] ** 2 + EDGES[:-1] ** 2) / 2)
        # Pencils that pass a place at an angle stand around the ray to it, turned about it.
        eta, off, turn = OFF_AXIS[:, None, None], middle[:, None], TURNS
        cosine = np.cos(eta) * np.cos(off) + np.sin(eta) * np.sin(off) * np.cos(turn)
        intensity = self.intensity(np.arccos(np.clip(cosine, -1, 1)))
        weight, turned = intensity.mean(-1), (intensity * np.cos(turn)).mean(-1)
        self.flux = np.stack([pencil.radial @ weight.T, pencil.away @ turned.T])
        # A photon crosses a sphere once, except for the few that turn back.
        square = pencil.squares @ np.square(weight).T - self.flux[0] ** 2
        self.error = np.sqrt(np.maximum(square, 0.0) / pencil.photons)
        self._splines = [RectBivariateSpline(RADII_M, OFF_AXIS, part) for part in self.flux]

    def intensity(self, eta: Array) -> Array:
        """Return that of the lamp at angles off its axis, rad."""
        return radiance(self.gaussians, eta / self.sigma)

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

    def images(self, model: ForwardModel, poses: Array) -> Array:
        """Return the light on a model's array at poses ``(m, 5)``, shape ``(m, side, side)``.

        It is the net flux through the face of each detector; 0 where that comes from behind.
        """
        rays = model.rays(poses, np.zeros(len(poses)))
        eta, cosine = np.sqrt(2 * rays[HALF_SQUARE]), rays[COSINE]
        radial, away = self.vector(rays[RANGE], eta)
        # The normal's part across the ray, towards the axis.
        lean = (cosine * np.cos(eta) + rays[AXIAL]) / np.maximum(np.sin(eta), 1e-12)
        light = np.maximum(radial * cosine + away * lean, 0.0)
        return light.reshape(len(poses), *model.image_shape)


class PhotonSea:
    """A scene in the water of a pencil, where its lamp gives its reference reading.

    Lamp, array and what acts on it are the scene's, no effect between; `model` reads the light.
    """

    def __init__(self, scene: Scene, pencil: Pencil) -> None:
        self.model = ForwardModel(scene)
        sigma_rad = float(np.radians(scene.lamp.beam_sigma_deg))
        self._lamp = Lamp(pencil, sigma_rad, gaussians_of(scene.lamp))
        self._optics, self._power = self.model.optics(), 1.0
        aligned = np.array([[-scene.lamp.reference_range_m, 0.0, 0.0, 0.0, 0.0]])
        self._power = scene.lamp.reference_counts / self.light(aligned).max()

    def light(self, poses: Array) -> Array:
        """Return the light at poses ``(m, 5)``, counts, shape ``(m, side, side)``."""
        images = self._power * self._lamp.images(self.model, poses)
        flat = images.reshape(1, len(poses), -1)
        detect(self._optics, np.zeros((0, len(poses), 1)), flat)
        return flat.reshape(images.shape)
