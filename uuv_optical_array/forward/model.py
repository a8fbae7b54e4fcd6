"""From pose to image: the forward model of a scene."""

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.errors import expect
from uuv_optical_array.core.geometry import PITCH, Array, lamp_in_body, write_lamp_slopes
from uuv_optical_array.core.numerics.elementwise import stack, workspace
from uuv_optical_array.forward import effects
from uuv_optical_array.forward.array import build_array
from uuv_optical_array.forward.effects import forms
from uuv_optical_array.forward.effects.forms import Background, Blur, Gain, Shade
from uuv_optical_array.forward.lamp.beam import gaussians_of
from uuv_optical_array.forward.lamp.lamps import GEOMETRY, TURN, lamps_in_numbers, one_of_lamps
from uuv_optical_array.forward.light import RAY_ROWS
from uuv_optical_array.forward.optics import (
    BACKGROUND,
    BLUR,
    GAIN,
    LAWS,
    SHADE,
    Optics,
    detect,
    trace,
    write_light,
)
from uuv_optical_array.forward.prior import (
    AMBIENT,
    ATTENUATION,
    BEAM_SIGMA,
    DAYLIGHT,
    FLOOR,
    OWN_FLOOR,
    OWN_GEOMETRY,
    OWN_POWER,
    POWER,
    RADIUS,
    ROLL,
    SCATTERING,
    SHADES,
    of_lamp,
    shade_modes,
    unknown_forms,
)
from uuv_optical_array.forward.readout import Readout
from uuv_optical_array.forward.scene import Scene

BLOCK_READINGS = 51_200  # whose rays fit into the second level of the cache
STEP_KINDS = {Background: BACKGROUND, Gain: GAIN, Blur: BLUR, Shade: SHADE}

T = TypeVar("T")


class ForwardModel(Readout):
    """Images of a scene's array at given poses.

    Images have shape ``(..., side, side)``, in counts; row 0 is the top of the array,
    column 0 its port edge. The images of L lamps lie below one another, ``(..., L side, side)``.

    Parameters
    ----------
    scene
        A checked scene.

    Attributes
    ----------
    noise, own_noise, analogue_noise, saturation_counts
        Of readings, as of `Readout`.
    nuisances : tuple of str
        Settings that a prior may leave uncertain, by dotted name, with `prior.unknown_forms`.
        Offsets of `prior.LOGARITHMS`, and of the power of each of several lamps, are those of the
        logarithm; the others have the setting's unit.

    Raises
    ------
    ValueError
        Where the lamp cannot be set because no light reaches the aligned array.
    """

    def __init__(self, scene: Scene) -> None:
        expect(scene, Scene, "scene", "what load_scene returns")
        self.scene = scene
        self.array = build_array(scene.array)
        self._forms = effects.plan(scene.effects, self.array)
        self._moving = [form.factor for form in self._of(forms.Moving)]
        super().__init__(scene, self._forms)
        known = set[str]()
        if self.modulated:
            self._forms = tuple(f for f in self._forms if getattr(f, "nuisance", "") != AMBIENT)
            known |= {*DAYLIGHT}
        named = [form.nuisance for form in self._of(forms.Transmission)]
        named += [form.nuisance for kind in (Background, Gain) for form in self._of(kind)]
        if self._of(forms.Scattering):
            named.append(SCATTERING)
            known.add(ATTENUATION)  # a sea has its absorption in its place
        unknown = unknown_forms(self.array.side)
        self._unknown = {name: unknown[name] for name in unknown if name not in {*named, *known}}
        lamps, side = range(len(scene.lamps)), self.array.side
        modes = np.vstack([np.ones(side**2), shade_modes(side)])
        for i, own in zip(lamps, np.eye(len(lamps)), strict=True):
            for setting, mode in zip((OWN_POWER, *SHADES), modes, strict=True):
                name = of_lamp(i, setting)
                self._unknown[name] = Shade(np.kron(own, mode), nuisance=name)
        floors = [lamp.floor_counts for lamp in scene.lamps] or [scene.lamp.floor_counts]
        if "demodulation" in scene.effects:
            for i, (own, floor) in enumerate(zip(np.eye(len(floors)), floors, strict=True)):
                name = of_lamp(i, OWN_FLOOR) if lamps else FLOOR
                constant = Background(np.kron(own, modes[0]), floor, name)
                if floor:
                    self._forms, named = (constant, *self._forms), [*named, name]
                else:
                    self._unknown[name] = constant
        geometry = [of_lamp(i, setting) for i in lamps for setting in OWN_GEOMETRY]
        # The radius of a planar array changes nothing.
        names = POWER, BEAM_SIGMA, RADIUS, *named, *self._unknown, *geometry, ROLL
        self.nuisances = tuple(dict.fromkeys(filter(None, names if lamps else names[:-1])))
        self._gaussians = gaussians_of(scene.lamp)
        # The power of all lamps is that of one at the origin.
        sigma_rad = float(np.radians(scene.lamp.beam_sigma_deg))
        self.power, self._lamps = 1.0, lamps_in_numbers((), sigma_rad, scene.lamp.behind_m)
        aligned = np.array([-scene.lamp.reference_range_m, 0.0, 0.0, 0.0, 0.0])
        # The slope by the power's logarithm is the lamp's light, without rounding by daylight.
        _, slopes = self.linearised(aligned, offsets={POWER: np.zeros(())})
        unit_reading = float(slopes[:, -1].max())
        if unit_reading < 1e-200:
            raise ValueError(
                f"scene {scene.name}: lamp.reference_range_m: {scene.lamp.reference_range_m:g} m "
                "gives the aligned array no light; give a range at which the array sees the lamp"
            )
        self.power = scene.lamp.reference_counts / unit_reading
        self._lamps = lamps_in_numbers(scene.lamps, sigma_rad, scene.lamp.behind_m)
        self.image_shape = self._lamps.shape[1] * self.array.side, self.array.side

    def with_beam(self, gaussians: Array) -> "ForwardModel":
        """Return the model with another shape of the beam, as `beam.gaussians_of` returns it.

        The light on the axis of the beam is the same.
        """
        other = copy.copy(self)
        other._gaussians = np.ascontiguousarray(gaussians, dtype=float)
        return other

    def _of(self, kind: type[T]) -> list[T]:
        return [form for form in self._forms if isinstance(form, kind)]

    def optics(self, nuisances: Sequence[str] = ()) -> Optics:
        """Return the scene in numbers; the `nuisances` have offsets, in this order.

        ValueError for a setting that the scene does not have.
        """
        for name in nuisances:
            if name not in self.nuisances:
                raise ValueError(f"{name}: not a nuisance of scene {self.scene.name}")

        def index_of(name: str) -> int:
            return nuisances.index(name) if name in nuisances else -1

        unknown = [form for name, form in self._unknown.items() if name in nuisances]
        passed = self._of(forms.Transmission)
        passed += [form for form in unknown if isinstance(form, forms.Transmission)]
        # Light that the scene does not name comes before the effects on the array.
        steps: list[Any] = [form for form in unknown if isinstance(form, forms.Step)]
        steps += [form for form in self._forms if isinstance(form, forms.Step | Blur)]
        blurs, count = self._of(Blur), self._lamps.shape[1]
        values = np.zeros((len(steps), count * self.array.side**2))
        for row, step in zip(values, steps, strict=True):
            row[:] = 0.0 if isinstance(step, Blur) else np.resize(step.values, row.shape)
        lamp_at = np.full((GEOMETRY, count), index_of(ROLL), dtype=np.int64)
        for i in range(count):
            lamp_at[:TURN, i] = [index_of(of_lamp(i, setting)) for setting in OWN_GEOMETRY]
        return Optics(
            detectors=np.ascontiguousarray(np.hstack([self.array.positions, self.array.normals]).T),
            radius_m=float(self.scene.array.radius_m or 0.0),
            power=float(self.power),
            lamps=self._lamps,
            lamp_at=lamp_at,
            gaussians=self._gaussians,
            scattering_per_m=float(
                sum(form.scattering_per_m for form in self._of(forms.Scattering))
            ),
            nuisances=len(nuisances),
            power_at=index_of(POWER),
            sigma_at=index_of(BEAM_SIGMA),
            scattering_at=index_of(SCATTERING),
            radius_at=index_of(RADIUS),
            laws=np.array([LAWS.index(form.law) for form in passed], dtype=np.int64),
            law_settings=np.array([form.settings for form in passed]).reshape(len(passed), 3),
            law_at=np.array([index_of(form.nuisance) for form in passed], dtype=np.int64),
            step_kinds=np.array([STEP_KINDS[type(step)] for step in steps], dtype=np.int64),
            step_values=values,
            step_scales=np.array([getattr(step, "scale", 0.0) for step in steps], dtype=float),
            step_at=np.array([index_of(getattr(it, "nuisance", "")) for it in steps], np.int64),
            blur=np.ascontiguousarray(blurs[0].matrix) if blurs else np.zeros((0, 0)),
        )

    def light(
        self,
        poses: ArrayLike,
        roll: ArrayLike = 0.0,
        offsets: Mapping[str, Array] = MappingProxyType({}),
        time_s: ArrayLike | None = None,
        on_array: bool = True,
    ) -> Array:
        """Light that arrives at the detectors, before any electronics.

        Parameters
        ----------
        poses
            ``(x, y, z, pitch, yaw)`` of the follower in ``beacon``, m and rad, shape ``(..., 5)``.
        roll
            Roll of the follower, rad, broadcast to ``(...)``.
        offsets
            Offsets of nuisance settings, by name, each of shape ``(...)``: see `nuisances`.
        time_s
            Time of each image, s, broadcast to ``(...)``, for flicker, drift and plume. ``None``:
            the scene without them, as estimators know it.
        on_array
            Whether it is behind daylight, blur and gains, or that of the lamp alone, for
            `on_array`.

        Returns
        -------
        Array
            Shape ``(..., side, side)``, counts, >= 0.

        Raises
        ------
        ValueError
            For poses that are not five finite numbers each, or an offset of a setting that the
            scene does not have.
        """
        image, shape = self._propagate(poses, roll, offsets, time_s, False, on_array)
        return image[0].reshape(*shape, *self.image_shape)

    def on_array(
        self, arriving: Array, offsets: Mapping[str, Array] = MappingProxyType({})
    ) -> Array:
        """Return the light of lamps behind daylight, blur and gains, counts, as `light` does."""
        shape = arriving.shape[: arriving.ndim - 2]
        image = arriving.reshape(1, -1, self.image_shape[0] * self.array.side).copy()
        nuisances = self._in_rows(offsets, shape)
        # Light too dim for a float64 counts as none.
        with np.errstate(under="ignore"):
            detect(self.optics(tuple(offsets)), nuisances, image)
        return image.reshape(*shape, *self.image_shape)

    def _in_rows(self, offsets: Mapping[str, Array], shape: tuple[int, ...]) -> Array:
        """Return offsets for poses of a shape as ``(q, m, 1)``."""
        rows = [np.broadcast_to(offset, shape).reshape(-1) for offset in offsets.values()]
        return np.array(rows, dtype=float).reshape(len(rows), math.prod(shape), 1)

    def linearised(
        self,
        poses: ArrayLike,
        roll: ArrayLike = 0.0,
        offsets: Mapping[str, Array] = MappingProxyType({}),
    ) -> tuple[Array, Array]:
        """Light at given poses, with its analytic Jacobian.

        Parameters
        ----------
        poses, roll, offsets
            As in `light`, with its errors.

        Returns
        -------
        image : Array
            Light, shape ``(..., n)``, counts, of the n readings.
        jacobian : Array
            By x, y, z, pitch, yaw and each of `offsets`, in counts per m, rad and the
            setting's unit, shape ``(..., n, 5 + len(offsets))``.
        """
        image, shape = self._propagate(poses, roll, offsets, None, True)
        jacobian = np.moveaxis(image[1:], 0, -1)
        n = image.shape[-1]
        return image[0].reshape(*shape, n), jacobian.reshape(*shape, n, len(image) - 1)

    def _propagate(
        self,
        poses: ArrayLike,
        roll: ArrayLike,
        offsets: Mapping[str, Array],
        time_s: ArrayLike | None,
        differentiate: bool,
        on_array: bool = True,
    ) -> tuple[Array, tuple[int, ...]]:
        """Return the light with its slopes, shape ``(r, m, n)``, and the shape of the poses."""
        poses = np.asarray(poses, dtype=float)
        if poses.shape[-1:] != (5,) or not np.isfinite(poses).all():
            raise ValueError(
                f"poses: shape {poses.shape}, {(~np.isfinite(poses)).sum()} nan or infinite; give "
                "five finite numbers each: x, y, z in m, pitch and yaw in rad"
            )
        shape = np.broadcast_shapes(poses.shape[:-1], np.shape(roll))
        flat = np.ascontiguousarray(np.broadcast_to(poses, (*shape, 5)).reshape(-1, 5).T)[..., None]
        rolls = np.broadcast_to(np.asarray(roll, dtype=float), shape).reshape(-1, 1)
        optics = self.optics(tuple(offsets))
        count, n, size = flat.shape[1], self._lamps.shape[1] * self.array.side**2, len(offsets)
        nuisances = self._in_rows(offsets, shape)
        moving = [] if time_s is None else self._moving
        times = np.broadcast_to(0.0 if time_s is None else np.asarray(time_s, float), shape)
        times = times.reshape(-1, 1)
        image = np.empty((6 + size if differentiate else 1, count, n))
        step = max(1, BLOCK_READINGS // n)
        # Light too dim for a float64 counts as none.
        with np.errstate(under="ignore"):
            for start in range(0, count, step):
                part = slice(start, start + step)
                lamp = stack(*lamp_in_body(flat[:, part], rolls[part]))
                slopes = np.zeros((6, 5 if differentiate else 0, *lamp.shape[1:]))
                if differentiate:
                    write_lamp_slopes(flat[:, part], rolls[part], lamp, slopes)
                offset, attitude = nuisances[:, part], (*flat[PITCH:, part], rolls[part])
                write_light(optics, lamp, slopes, attitude, offset, image[:, part])
                if moving:
                    image[0, part] *= self._moved(optics, lamp, attitude, offset, times[part])
                if on_array:
                    detect(optics, offset, image[:, part])
        return image, shape

    def _moved(
        self, optics: Optics, lamp: Array, attitude: Any, offset: Array, time_s: Array
    ) -> Array:
        """Return the factor of what moves, for each reading, shape ``(m, n)``."""
        factors = []
        for rays, axis in self._traced(optics, lamp, attitude, offset):
            parts = [form(time_s, rays, axis) for form in self._moving]
            factors.append(np.prod(np.broadcast_arrays(*parts), axis=0))
        return np.concatenate(factors, axis=-1)

    def _traced(
        self, optics: Optics, lamp: Array, attitude: Any, offset: Array
    ) -> Iterator[tuple[Array, Array]]:
        """Yield the rays from each lamp, shape ``(14, m, n)``, and its axis in ``base_link``."""
        for i in range(optics.lamps.shape[1]):
            known, none = (optics.lamps, optics.lamp_at, i, attitude, offset), np.zeros((6, 0))
            one = one_of_lamps(*known, lamp, none, none, none)
            rays = workspace(RAY_ROWS, lamp[0], self.array.side**2)
            trace(optics, one, offset, rays)
            yield rays, np.stack(np.broadcast_arrays(*one[3:]))

    def expected(self, poses: ArrayLike, roll: ArrayLike = 0.0) -> Array:
        """Image without noise and converter: `light`, up to the level of `saturation`."""
        return np.minimum(self.light(poses, roll), self.saturation_counts)

    def expose(
        self,
        poses: ArrayLike,
        rng: np.random.Generator | None = None,
        roll: ArrayLike = 0.0,
        offsets: Mapping[str, Array] = MappingProxyType({}),
        time_s: ArrayLike | None = None,
    ) -> Array:
        """Image as the array reads it: light, noise, electronics, converter.

        Parameters
        ----------
        poses, roll, offsets, time_s
            As in `light`.
        rng
            Source of the noise; a scene without noise draws nothing and needs none.
        """
        return self.read(self.light(poses, roll, offsets, time_s), rng)

    def with_gains(self, light: Array, gains: Array) -> Array:
        """Return light, ``(..., L side, side)``, as detectors of other gains read it.

        Gains have shape ``(..., side, side)``; a pedestal is added behind them.
        """
        count = self._lamps.shape[1]
        black = self.noise.black
        return black + np.concatenate([gains] * count, axis=-2) * (light - black)

    def rays(self, poses: Array, rolls: Array) -> Array:
        """Return the rays to each detector from each lamp, as `light.ray`, shape ``(14, m, L n)``.

        Poses and rolls have shapes ``(m, 5)`` and ``(m,)``, m and rad.
        """
        components, roll = poses.T[..., None], rolls[:, None]
        lamp, attitude = stack(*lamp_in_body(components, roll)), (*components[PITCH:], roll)
        traced = self._traced(self.optics(), lamp, attitude, np.zeros((0, len(poses), 1)))
        return np.concatenate([rays for rays, _ in traced], axis=-1)
