"""The fit of one image by kernels that Numba compiles (the extra ``fast``), the same to rounding.

A frame of 25 readings keeps NumPy busy with being called; `fit_kernel` does without. Numba is
imported when the first of these fits is made.
"""

import importlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.least_squares.solver import (
    ARRIVED,
    MAX_ITERATIONS,
    Evaluation,
    ImageFit,
    Prior,
)
from uuv_optical_array.forward.effects import EFFECTS, MOVING, Stage
from uuv_optical_array.forward.effects.water import hanning_blur
from uuv_optical_array.forward.light import LateRays, Light
from uuv_optical_array.forward.model import MIN_VARIANCE, ForwardModel

COSINE_POWER, RIM = 1, 2  # forms of `effects.field_of_view`
# Effects that the kernel knows, and those that do nothing in an estimator; a scene with another
# one is fitted by NumPy.
COVERED = MOVING | {
    "attenuation",
    "beam_spread",
    "field_of_view",
    "ambient",
    "forward_scatter",
    "responsivity",
    "detector_faults",
    "sensor_noise",
    "shot_noise",
    "photodiode",
    "saturation",
    "adc",
}


class Sea(NamedTuple):
    """What a scene says about an image, in numbers; see `_sea`.

    Parameters
    ----------
    detectors
        Their positions and normals, shape ``(6, n)``.
    chart
        Standard deviation of the beam, rad; attenuation, 1/m; 0 for a curved array, else the
        `Chart.share`; centre of the array, m.
    power
        As in `light.irradiance`.
    scattering_per_m, scattering_variance
        Of `effects.beam_spread`, 1/m and rad^2; 0: none.
    view_form, view_values
        Of `effects.field_of_view`: 0, `COSINE_POWER` with the power less one, or `RIM` with the
        cosine and the width of its edge.
    ambient
        Level, counts.
    blur
        Of one axis, shape ``(side, side)``; ``(0, 0)``: none.
    gain, drift_per_c, floor
        Of each detector, shape ``(n,)``, its change with temperature, and its reading in the dark.
    still, steep
        Variance of a dark reading, counts^2, and its slope by the light, counts.
    least_variance
        And never less than this, counts^2.
    low, high
        As in `likelihood.Limits`.
    std
        Of the prior: pose, then nuisances, shape ``(p,)``.
    reach
        Longest step of a fit by coordinate, shape ``(p,)``.
    at_power, at_k, at_ambient, at_temperature
        Place of each nuisance among the coordinates; -1: fixed.
    """

    detectors: Array
    chart: tuple[float, float, float, float, float, float]
    power: float
    scattering_per_m: float
    scattering_variance: float
    view_form: int
    view_values: tuple[float, float]
    ambient: float
    blur: Array
    gain: Array
    drift_per_c: float
    floor: Array
    still: float
    steep: float
    least_variance: float
    low: float
    high: float
    std: Array
    reach: Array
    at_power: int
    at_k: int
    at_ambient: int
    at_temperature: int


def _sea(fit: ImageFit) -> Sea:
    """Take the numbers from the scene of a fit."""
    model, names = fit.model, fit.names
    array, scene = model.array, model.scene
    effects = scene.effects
    lit_by = [name for name in effects if EFFECTS[name][0] is Stage.LIGHT]
    # What each detector makes of darkness and of one count.
    shape = array.side, array.side
    dark, unit = Light(np.zeros(shape)), Light(np.ones(shape))
    for name, step in zip(lit_by, model.plan.light, strict=True):
        if name in ("responsivity", "detector_faults"):
            for light in (dark, unit):
                step(light, LateRays(array, np.zeros(5), np.zeros(())))
    blur: Array = np.zeros((0, 0))
    if "forward_scatter" in effects:
        window_m = effects["forward_scatter"]["window_m"]
        blur = hanning_blur(array.side, array.spacing_m, window_m)
    spread = effects.get("beam_spread", {"scattering_per_m": 0.0, "scattering_angle_deg": 0.0})
    view_form, view_values = _view(effects.get("field_of_view", {}))
    still, steep = model.variance(np.zeros(1))
    places = {name: 5 + i for i, name in enumerate(names)}
    return Sea(
        detectors=np.ascontiguousarray(np.hstack([array.positions, array.normals]).T),
        chart=(
            fit.chart.beam_sigma_rad,
            float(fit.chart.k_per_m),
            fit.chart.share if fit.chart.planar else 0.0,
            *fit.chart.centre.tolist(),
        ),
        power=float(model.power),
        scattering_per_m=float(spread["scattering_per_m"]),
        scattering_variance=float(np.radians(spread["scattering_angle_deg"]) ** 2),
        view_form=view_form,
        view_values=view_values,
        ambient=float(effects.get("ambient", {}).get("level_counts", 0.0)),
        blur=blur,
        gain=(unit.image - dark.image).ravel(),
        drift_per_c=float(effects.get("responsivity", {}).get("drift_per_c", 0.0)),
        floor=dark.image.ravel(),
        still=float(still[0]),
        steep=float(steep[0]),
        least_variance=MIN_VARIANCE,
        low=float(model.limits.low),
        high=float(model.limits.high),
        std=fit.std,
        reach=fit.reach,
        at_power=places.get("lamp.power", -1),
        at_k=places.get("attenuation.k_per_m", -1),
        at_ambient=places.get("ambient.level_counts", -1),
        at_temperature=places.get("responsivity.temperature_c", -1),
    )


def _view(settings: Mapping[str, Any]) -> tuple[int, tuple[float, float]]:
    if "cosine_power" in settings:
        return COSINE_POWER, (settings["cosine_power"] - 1, 0.0)
    if "half_angle_deg" in settings:
        half, edge = np.radians(settings["half_angle_deg"]), np.radians(settings["edge_deg"])
        return RIM, (float(np.cos(half)), float(0.5 * edge * np.sin(half)))
    return 0, (0.0, 0.0)


def _rows(values: Array, count: int) -> Array:
    """Repeat values for each place, where they are those of all."""
    if values.ndim == 2:
        return values
    # Never read-only: that is another type, for which all would be compiled once more.
    rows: Array = np.empty((count, len(values)))
    rows[:] = values
    return rows


class CompiledFit(ImageFit):
    """An `ImageFit` whose evaluations and descents Numba has compiled.

    Parameters
    ----------
    model, prior
        As in `ImageFit`.

    Raises
    ------
    ValueError
        Where Numba is not installed, or not for this NumPy, or does not know an effect of the
        scene.
    """

    def __init__(self, model: ForwardModel, prior: Prior) -> None:
        super().__init__(model, prior)
        if unknown := sorted(set(model.scene.effects) - COVERED):
            raise ValueError(
                f"compiled: {unknown[0]} is no effect of the kernel; let NumPy fit this scene"
            )
        try:
            self._kernel = importlib.import_module(
                "uuv_optical_array.estimation.least_squares.fit_kernel"
            )
        except ImportError as error:
            raise ValueError(
                f"compiled: {error}; install Numba: pip install -e '.[fast]'"
            ) from None
        self._sea = _sea(self)
        # So that no frame has to wait for the compiler.
        readings, start = np.zeros(model.array.side**2), np.zeros((1, len(self.mean)))
        self.descend(readings, start, 0.0)
        self.evaluate(readings, start, 0.0)
        self.cost(readings, start, 0.0)
        self.light(start[0], 0.0)

    def evaluate(
        self, readings: Array, coordinates: Array, roll: float, mean: Array | None = None
    ) -> Evaluation:
        """As `ImageFit.evaluate`."""
        readings = _rows(readings, len(coordinates))
        mean = _rows(self.mean if mean is None else mean, len(coordinates))
        return Evaluation(*self._kernel.evaluate(self._sea, readings, coordinates, roll, mean))

    def cost(self, readings: Array, coordinates: Array, roll: float) -> tuple[Array, Array, Array]:
        """As `ImageFit.cost`."""
        return self._kernel.costs(self._sea, readings, coordinates, roll, self.mean)

    def light(self, coordinates: Array, roll: float) -> Array:
        """As `ImageFit.light`."""
        return self._kernel.light_at(self._sea, coordinates, roll)

    def descend(
        self, readings: Array, coordinates: Array, roll: float, mean: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """As `ImageFit.descend`."""
        readings = _rows(readings, len(coordinates))
        mean = _rows(self.mean if mean is None else mean, len(coordinates))
        return self._kernel.descend(
            self._sea, readings, coordinates, roll, mean, MAX_ITERATIONS, ARRIVED
        )


def image_fit(model: ForwardModel, prior: Prior, compiled: bool | None = None) -> ImageFit:
    """Return the fit of a model's images, compiled where that is asked for and can be.

    Parameters
    ----------
    model, prior
        As in `ImageFit`.
    compiled
        Whether Numba has to be there, or must not be used; ``None``: where it is installed.

    Raises
    ------
    ValueError
        As `CompiledFit`, where it is asked for.
    """
    if compiled is None:
        try:
            return CompiledFit(model, prior)
        except ValueError:
            return ImageFit(model, prior)
    return CompiledFit(model, prior) if compiled else ImageFit(model, prior)
