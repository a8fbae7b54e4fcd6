"""From pose to image: the forward model of a scene."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.likelihood import Limits
from uuv_optical_array.forward import effects
from uuv_optical_array.forward import light_batch as bulk
from uuv_optical_array.forward.array import build_array
from uuv_optical_array.forward.light import (
    LateRays,
    Light,
    irradiance,
    irradiance_with_derivatives,
    lamp_derivatives,
    lamp_in_body,
    trace,
)
from uuv_optical_array.forward.scene import Scene

# Settings of a scene that may be off, and the unit of their offset; the power's is its logarithm.
NUISANCES = {
    "lamp.power": "",
    "attenuation.k_per_m": "1/m",
    "ambient.level_counts": "counts",
    "responsivity.temperature_c": "deg C",
}
# A scene without noise is read as if to a thousandth of a count.
MIN_VARIANCE = 1e-6


class ForwardModel:
    """Images of a scene's array at given poses, planned once.

    Images have shape ``(..., side, side)``, in counts; row 0 is the top of the array,
    column 0 its port edge.

    Parameters
    ----------
    scene
        A checked scene.
    compiled
        Whether the light at very many poses is worked out by a kernel that Numba compiles (the
        extra ``fast``), the same to rounding; ``None``: where one call repays loading it.

    Raises
    ------
    ValueError
        Where the lamp cannot be set because no light reaches the aligned array, or where Numba
        is asked for and not installed.
    """

    def __init__(self, scene: Scene, compiled: bool | None = None) -> None:
        if compiled:
            bulk.kernel()
        self.compiled = compiled
        self.scene = scene
        self.array = build_array(scene.array)
        self.plan = effects.plan(scene.effects, self.array, scene.lamp)
        self._beam_sigma_rad = float(np.radians(scene.lamp.beam_sigma_deg))
        converted = "adc" in scene.effects
        clipped = converted or "saturation" in scene.effects
        self.limits = Limits(
            0.0 if converted else -np.inf, scene.full_scale_counts if clipped else np.inf
        )
        # Rounding is uniform within a count.
        self.rounding_variance = 1 / 12 if converted else 0.0
        self.power = 1.0
        aligned = np.array([-scene.lamp.reference_range_m, 0.0, 0.0, 0.0, 0.0])
        lit = self.light(aligned)
        self.power = 0.0
        unit_reading = float((lit - self.light(aligned)).max())
        if unit_reading < 1e-200:
            raise ValueError(
                f"scene {scene.name}: lamp.reference_range_m: {scene.lamp.reference_range_m:g} m "
                "gives the aligned array no light; move it into the water in front of the array"
            )
        self.power = scene.lamp.reference_counts / unit_reading

    def light(
        self,
        poses: ArrayLike,
        roll: ArrayLike = 0.0,
        offsets: Mapping[str, Array] = MappingProxyType({}),
        time_s: ArrayLike | None = None,
    ) -> Array:
        """Light that arrives at the detectors, before any electronics.

        Parameters
        ----------
        poses
            ``(x, y, z, pitch, yaw)`` of the follower in ``beacon``, m and rad,
            shape ``(..., 5)``.
        roll
            Roll of the follower, rad, broadcast to ``(...)``.
        offsets
            Offsets of nuisance settings, by name, each of shape ``(...)``: see `NUISANCES`.
        time_s
            Moment of each image, s, broadcast to ``(...)``, for what moves: flicker, drift, a
            plume. ``None``: the scene without them, as estimators know it.

        Returns
        -------
        Array
            Shape ``(..., side, side)``, counts, >= 0.

        Raises
        ------
        ValueError
            For an offset of a setting that the scene does not have.
        """
        poses = np.asarray(poses, dtype=float)
        side = self.array.side
        if offsets or poses.size * side**2 <= 5 * bulk.BLOCK_READINGS:
            lamp, axis = lamp_in_body(poses, roll)
            if time_s is not None:
                time_s = np.broadcast_to(np.asarray(time_s, dtype=float), lamp.shape[:-1])
            return self._propagate(lamp, axis, offsets, False, time_s).image
        images = np.empty((*np.broadcast_shapes(poses.shape[:-1], np.shape(roll)), side, side))
        self.write_light(images, poses, roll, time_s)
        return images

    def write_light(
        self,
        images: Array,
        poses: ArrayLike,
        roll: ArrayLike = 0.0,
        time_s: ArrayLike | None = None,
    ) -> None:
        """Write `light` at very many poses into an array, which may be used again and again.

        Parameters
        ----------
        images
            Result, shape ``(..., side, side)``, contiguous, counts.
        poses, roll, time_s
            As in `light`, broadcast to ``(...)``.

        Raises
        ------
        ValueError
            For images that are not contiguous or of another shape.
        """
        shape, side = images.shape[:-2], self.array.side
        if images.shape != (*shape, side, side) or not images.flags.c_contiguous:
            raise ValueError(f"images: shape {images.shape}; give contiguous (..., {side}, {side})")
        poses = np.broadcast_to(poses, (*shape, 5)).reshape(-1, 5)
        rolls = np.broadcast_to(np.asarray(roll, dtype=float), shape).reshape(-1)
        moments = None
        if time_s is not None:
            moments = np.broadcast_to(np.asarray(time_s, dtype=float), shape).reshape(-1)
        stack = images.reshape(-1, side, side)
        # The first effect, where it is Beer's law, goes into the same exponential.
        dimmed = next(iter(self.scene.effects), None) == "attenuation"
        lamp_light = bulk.BulkLight(
            self.array,
            self._beam_sigma_rad,
            self.power,
            self.scene.effects["attenuation"]["k_per_m"] if dimmed else 0.0,
            bulk.worthwhile(images.size) if self.compiled is None else self.compiled,
        )
        for start in range(0, len(stack), lamp_light.block):
            part = slice(start, start + lamp_light.block)
            image, where = stack[part], (poses[part], rolls[part])
            lamp_light.write(image.reshape(-1, side**2), *where)
            light = Light(image, time_s=None if moments is None else moments[part])
            rays = LateRays(self.array, *where)
            with np.errstate(under="ignore"):
                for step in self.plan.light[dimmed:]:
                    step(light, rays)
            if light.image is not image:
                image[...] = light.image

    def light_by_lamp(
        self, lamp: Array, axis: Array, offsets: Mapping[str, Array] = MappingProxyType({})
    ) -> Array:
        """As `light`, from what `light.lamp_in_body` returns."""
        return self._propagate(lamp, axis, offsets, False).image

    def linearised(
        self,
        poses: ArrayLike,
        roll: ArrayLike = 0.0,
        offsets: Mapping[str, Array] = MappingProxyType({}),
    ) -> tuple[Array, Array]:
        """Light at given poses, with its analytic Jacobian.

        Parameters
        ----------
        poses, roll
            As in `light`.
        offsets
            Offsets of nuisance settings, by name, each of shape ``(...)``: see `NUISANCES`.

        Returns
        -------
        image : Array
            Light, shape ``(..., side * side)``, counts.
        jacobian : Array
            By x, y, z, pitch, yaw and each of `offsets`, in counts per m, rad and the
            setting's unit, shape ``(..., side * side, 5 + len(offsets))``.

        Raises
        ------
        ValueError
            For an offset of a setting that the scene does not have.
        """
        image, by_lamp = self.linearised_by_lamp(*lamp_in_body(poses, roll), offsets)
        by_pose = by_lamp[..., :6] @ lamp_derivatives(poses, roll)
        return image, np.concatenate([by_pose, by_lamp[..., 6:]], axis=-1)

    def linearised_by_lamp(
        self, lamp: Array, axis: Array, offsets: Mapping[str, Array] = MappingProxyType({})
    ) -> tuple[Array, Array]:
        """Light with its derivatives by where the lamp is and where it shines.

        Parameters
        ----------
        lamp, axis
            As `light.lamp_in_body` returns them, shape ``(..., 3)`` each.
        offsets
            As in `linearised`.

        Returns
        -------
        image : Array
            Light, shape ``(..., side * side)``, counts.
        derivatives : Array
            By lamp (3), axis (3) and each of `offsets`, shape
            ``(..., side * side, 6 + len(offsets))``.

        Raises
        ------
        ValueError
            As `linearised`.
        """
        light = self._propagate(lamp, axis, offsets, True)
        assert light.derivatives is not None
        pixels = self.array.side**2
        derivatives = light.derivatives.reshape(*light.derivatives.shape[:-2], pixels)
        return light.image.reshape(*light.image.shape[:-2], pixels), np.swapaxes(
            derivatives, -1, -2
        )

    def _propagate(
        self,
        lamp: Array,
        axis: Array,
        offsets: Mapping[str, Array],
        differentiate: bool,
        time_s: Array | None = None,
    ) -> Light:
        for name in offsets:
            if name not in NUISANCES or name.partition(".")[0] not in ("lamp", *self.scene.effects):
                raise ValueError(f"{name}: no nuisance of scene {self.scene.name}")
        # Light too dim for a float64 is no light.
        with np.errstate(under="ignore"):
            rays = trace(self.array, lamp, axis)
            shape = (*rays.range_m.shape[:-1], self.array.side, self.array.side)
            if differentiate:
                flat, derivatives = irradiance_with_derivatives(
                    rays, self.array, self._beam_sigma_rad, self.power
                )
                if offsets:
                    rows = np.zeros((*flat.shape[:-1], len(offsets), flat.shape[-1]))
                    derivatives = np.concatenate([derivatives, rows], axis=-2)
                planes = derivatives.reshape(*derivatives.shape[:-1], *shape[-2:])
                light = Light(flat.reshape(shape), planes, offsets, time_s)
            else:
                flat = irradiance(rays, self._beam_sigma_rad, self.power)
                light = Light(flat.reshape(shape), None, offsets, time_s)
            if "lamp.power" in offsets:
                light.dim(np.exp(offsets["lamp.power"])[..., None, None])
                light.slope_by("lamp.power", lambda: light.image)
            for step in self.plan.light:
                step(light, rays)
        return light

    def expected(self, poses: ArrayLike, roll: ArrayLike = 0.0) -> Array:
        """Image without noise and without rounding, as `light` with the electronics' limits."""
        image = self.light(poses, roll)
        for step in self.plan.analogue:
            image = step(image)
        return image

    def variance(self, light: Array) -> tuple[Array, Array]:
        """Variance of a reading, the sum over noise sources (eq. 7) and the rounding.

        Parameters
        ----------
        light
            What `light` returned, counts, any shape.

        Returns
        -------
        variance : Array
            counts^2, in the shape of `light`, >= `MIN_VARIANCE`.
        slope : Array
            Its derivative by the light, counts.
        """
        variance = np.full(light.shape, self.rounding_variance)
        slope = np.zeros(light.shape)
        for step in self.plan.noise:
            more, steeper = step(light)
            variance += more
            slope += steeper
        return np.maximum(variance, MIN_VARIANCE), slope

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

        Returns
        -------
        Array
            Shape ``(..., side, side)``, counts.
        """
        image = self.light(poses, roll, offsets, time_s)
        if self.plan.noise:
            if rng is None:
                raise ValueError("rng: missing; this scene has noise, pass a numpy Generator")
            variance = sum(step(image)[0] for step in self.plan.noise)
            image += np.sqrt(variance) * rng.standard_normal(image.shape)
        for step in (*self.plan.analogue, *self.plan.digital):
            image = step(image)
        return image
