"""From pose to image: the forward model of a scene."""

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array import effects
from uuv_optical_array.array import build_array
from uuv_optical_array.light import irradiance, trace
from uuv_optical_array.pose import Array
from uuv_optical_array.scene import Scene


class ForwardModel:
    """Images of a scene's array at given poses, planned once.

    Images have shape ``(..., side, side)``, in counts; row 0 is the top of the array,
    column 0 its port edge.

    Parameters
    ----------
    scene
        A checked scene.

    Raises
    ------
    ValueError
        Where the lamp cannot be set because no light reaches the aligned array.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.array = build_array(scene.array)
        self.plan = effects.plan(scene.effects, self.array)
        self._beam_sigma_rad = float(np.radians(scene.lamp.beam_sigma_deg))
        self.power = 1.0
        aligned = np.array([-scene.lamp.reference_range_m, 0.0, 0.0, 0.0, 0.0])
        unit_reading = float(self.light(aligned).max())
        if unit_reading < 1e-200:
            raise ValueError(
                f"scene {scene.name}: lamp.reference_range_m: {scene.lamp.reference_range_m:g} m "
                "gives the aligned array no light; move it into the water in front of the array"
            )
        self.power = scene.lamp.reference_counts / unit_reading

    def light(self, poses: ArrayLike, roll: ArrayLike = 0.0) -> Array:
        """Light that arrives at the detectors, before any electronics.

        Parameters
        ----------
        poses
            ``(x, y, z, pitch, yaw)`` of the follower in ``beacon``, m and rad,
            shape ``(..., 5)``.
        roll
            Roll of the follower, rad, broadcast to ``(...)``.

        Returns
        -------
        Array
            Shape ``(..., side, side)``, counts, >= 0.
        """
        # Light too dim for a float64 is no light.
        with np.errstate(under="ignore"):
            rays = trace(self.array, poses, roll)
            image = irradiance(rays, self._beam_sigma_rad, self.power)
            image = image.reshape(*image.shape[:-1], self.array.side, self.array.side)
            for step in self.plan.light:
                image = step(image, rays)
        return image

    def expected(self, poses: ArrayLike, roll: ArrayLike = 0.0) -> Array:
        """Image without noise and without rounding, as `light` with the electronics' limits."""
        image = self.light(poses, roll)
        for step in self.plan.analogue:
            image = step(image)
        return image

    def variance(self, light: Array) -> Array:
        """Variance of the noise on the light, the sum over its sources (eq. 7).

        Parameters
        ----------
        light
            What `light` returned, counts, shape ``(..., side, side)``.

        Returns
        -------
        Array
            counts^2, in the shape of `light`.
        """
        total = np.zeros(light.shape)
        for step in self.plan.noise:
            total += step(light)
        return total

    def expose(
        self, poses: ArrayLike, rng: np.random.Generator | None = None, roll: ArrayLike = 0.0
    ) -> Array:
        """Image as the array reads it: light, noise, electronics, converter.

        Parameters
        ----------
        poses, roll
            As in `light`.
        rng
            Source of the noise; a scene without noise draws nothing and needs none.

        Returns
        -------
        Array
            Shape ``(..., side, side)``, counts.
        """
        image = self.light(poses, roll)
        if self.plan.noise:
            if rng is None:
                raise ValueError("rng: missing; this scene has noise, pass a numpy Generator")
            image += np.sqrt(self.variance(image)) * rng.standard_normal(image.shape)
        for step in (*self.plan.analogue, *self.plan.digital):
            image = step(image)
        return image
