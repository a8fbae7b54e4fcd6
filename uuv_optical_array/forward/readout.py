"""From light to readings: noise, saturation, converter, and what lamps with another code leave."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.effects import forms
from uuv_optical_array.forward.effects.electronics import detection, largest_demodulated
from uuv_optical_array.forward.noise import ReadingNoise, reading_variance, variance_slope
from uuv_optical_array.forward.prior import AMBIENT
from uuv_optical_array.forward.scene import Scene


class Readout:
    """Reads the light of a scene's detectors.

    - analogue_noise: of a reading before it is rounded.
    - own_noise: by known gains and beam, rounding included.
    - noise: what the scene's prior does not know of gains and beam included.
    - saturation_counts: largest reading before the converter; inf: none.
    - modulated: whether lamps have codes, so that daylight leaves the readings.
    """

    def __init__(self, scene: Scene, effects: Sequence[Any]) -> None:
        """Take a scene, and the forms of its effects as `effects.plan` returns them."""

        def of(kind: type[Any]) -> list[Any]:
            return [form for form in effects if isinstance(form, kind)]

        noises, self._converters = of(forms.Noise), of(forms.Converter)
        self.saturation_counts = min(
            (form.level_counts for form in of(forms.Saturation)), default=np.inf
        )
        # Of lamps with another code: variance of a count, and by how much of one readings saturate
        # earlier than at the level of this lamp alone.
        self._beside_slope, self._beside_share, self._level_counts = 0.0, 0.0, np.inf
        variance = float(sum(form.variance for form in noises))
        slope = float(sum(form.slope for form in noises))
        square = float(sum(form.square for form in noises))
        self.modulated = bool(of(forms.Demodulation))
        for form in of(forms.Demodulation):
            # Daylight leaves the readings, and stays in their noise.
            level = sum(step.scale for step in of(forms.Background) if step.nuisance == AMBIENT)
            found = detection(form.waveform, scene.lamp_count)
            variance = found.noise_factor * (variance + slope * level)
            self._beside_slope = found.noise_factor * slope
            slope = slope * found.light_factor
            if np.isfinite(self.saturation_counts):
                self._beside_share = detection(form.waveform, 1).peak_factor / found.peak_factor
                self._level_counts = largest_demodulated(
                    self.saturation_counts,
                    level,
                    scene.lamp_count,
                    **scene.effects["demodulation"],
                )
                self.saturation_counts = scene.full_scale_counts
        low, high = -np.inf, self.saturation_counts
        rounding = 0.0
        for converter in self._converters:
            # Rounding is uniform within a count.
            low, high, rounding = 0.0, float(np.rint(min(converter.largest, high))), 1 / 12
        black = scene.black_counts
        self.analogue_noise = ReadingNoise(variance, slope, low, high, square, black)
        self.own_noise = self.analogue_noise._replace(variance=variance + rounding)
        self.noise = self.own_noise._replace(square=scene.prior.spread**2 + square)

    def variance(self, light: Array) -> tuple[Array, Array]:
        """Variance of readings by all noise and by rounding (eq. 7), and its slope by the light.

        Both have the shape of `light`, in counts^2 (>= `noise.MIN_VARIANCE`) and counts.
        """
        return reading_variance(light, self.noise), variance_slope(light, self.noise)

    def read(
        self,
        light: Array,
        rng: np.random.Generator | None = None,
        beside: Array | float = 0.0,
    ) -> Array:
        """Return the readings of light, of any shape: noise, saturation, converter.

        With `demodulation` the light of lamps with another code, `beside`, counts, which broadcasts
        to the `light`, stays in its shot noise and in what saturates alone. ValueError for a scene
        with noise and no generator.
        """
        image = light
        noise = self.analogue_noise
        if noise.variance or noise.slope or noise.square:
            if rng is None:
                raise ValueError("rng: missing; this scene has noise, pass a numpy Generator")
            lit = np.maximum(light - noise.black, 0.0)
            variance = noise.variance + (noise.slope + noise.square * lit) * lit
            variance = variance + self._beside_slope * beside
            image = light + np.sqrt(variance) * rng.standard_normal(light.shape)
        if np.any(beside):
            image = np.minimum(image, self._level_counts - self._beside_share * beside)
        return self.converted(image)

    def converted(self, image: Array) -> Array:
        """Apply saturation and converter to analogue readings, counts, any shape."""
        image = np.minimum(image, self.saturation_counts)
        for form in self._converters:
            image = np.clip(np.rint(image), 0, form.largest)
        return image
