"""The acceptance test of an array before its first dive: darkness, a torch, and the lamps."""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtri

from uuv_optical_array.calibration.wiring import TorchSweeps
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.estimate import Estimate
from uuv_optical_array.estimation.estimator import Estimator, NoPose
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.noise import reading_variance
from uuv_optical_array.forward.scene import Scene, scene_from_settings

SETTLE_S, LAMP_S = 5.0, 5.0  # of steady light: while hands leave the array, and what is tested
LAMP = (
    "lamp, or all lamps as they are mounted: switch on {:g} m ahead of base_link, aimed at the "
    "array; hold both still for 10 s"
)
FALSE_ALARM = 1e-6  # probability that a sound detector is called noisy
MAX_MISFIT = 1e-3  # and that sound light is called unexplained; a fit to exchanged lamps is worse
MAX_NOISE, MAX_LEVEL, MAX_FLICKER = 2.0, 0.02, 0.01  # times the scene's; of full scale; relative
# Standard deviations of the gains before a calibration, and of the roll of what hands hold, or of
# lamps that are exchanged: three of these look rolled by 120 deg.
SPREAD, ROLLED_DEG = 0.05, 30.0
MAX_OFF, MAX_TURN = 0.1, np.radians(10.0)  # of the range, and of a lamp that was placed by hand
# Ratio of the range that the light shows and the given one. Light falls by its square, so that a
# lamp may differ from the scene's by a factor of 1.4: twice what is expected of a rig as bought.
MAX_RANGE_RATIO = 1.4**0.5
MAX_PEDESTAL = 0.5  # by how much darkness may differ from the scene's pedestal, relative
# Probability that sound light of a detector is unlike what the others tell, and by how much it is.
UNLIKE, MOST = 1e-4, 1.25
MAX_ROLL_DEG = 20.0  # of several lamps that hands hold level
WATER_INDEX = 1.34
FULL = "at full scale: move the lamp away"
NOISY = "noise {0:.3g} counts, of the scene {1:.3g}: loose contact, hum or oscillation"
PEDESTAL = (
    "darkness reads {:.4g} counts, and the scene's pedestal is {:.4g}: give the sender and the "
    "scene the same (effects.pedestal or effects.demodulation.pedestal_counts)"
)
LEAKS = "reads {2:.3g} in the dark, the others {3:.3g}: cover it; else clean it"
UNFIT = "does not fit the lamp's light: clean its window, check its gain and solder"


class Verdict(NamedTuple):
    """What an acceptance test found.

    - detectors: what is wrong with each that failed, with its cure, by row and column.
    - whole: what is wrong with the whole.
    - dark_counts: median reading of darkness, and the scene's.
    - seen: pose of the array behind the lamp, as in `Estimate`; ``None``: the light is of no pose.
    """

    detectors: dict[tuple[int, int], str]
    whole: list[str]
    dark_counts: tuple[float, float]
    seen: Estimate | None = None


class Acceptance(TorchSweeps):
    """The sweeps, longer darkness before them, and the lamps at a known range after them."""

    first_dark_s = 10.0

    def __init__(self, scene: Scene, range_m: float, show: Callable[[str], None] = print) -> None:
        super().__init__(scene.array.detectors_per_side, scene.full_scale_counts, show)
        self._scene, self._range_m = scene, range_m
        self._told = np.array([-range_m, 0.0, 0.0, 0.0, 0.0])
        # By how much hands may miss it.
        off = range_m * np.array([MAX_RANGE_RATIO - 1, MAX_OFF, MAX_OFF])
        self._by_hand = np.append(off, [MAX_TURN, MAX_TURN])
        self._lamp: list[tuple[int, Array]] = []

    @property
    def complete(self) -> bool:
        """Whether the lamp, too, was seen for long enough."""
        lit = self._lamp
        return bool(lit) and lit[-1][0] - lit[0][0] >= (SETTLE_S + LAMP_S) * 1e9

    @property
    def missing(self) -> str:
        """What was not seen so far, as of the sweeps, and then of the lamp."""
        if text := super().missing:
            return text
        if self.complete:
            return ""
        if not self._lamp:
            return f"the lamp: {self._brightest()}; switch it on, aim it, and clear its way"
        lit = (self._lamp[-1][0] - self._lamp[0][0]) * 1e-9
        return f"the lamp: {lit:.2g} of {SETTLE_S + LAMP_S:g} s without a break were seen"

    def take(self, stamp_ns: int, image: Array) -> None:
        """Take one image, as `TorchSweeps` does, and then those of the lamp."""
        if self.wiring is None or self._background is None:
            super().take(stamp_ns, image)
            if self.wiring is not None:
                self._show(LAMP.format(self._range_m))
        elif not self.complete:
            readings = self._by_lamp(image)
            self._rise = float((readings.sum(axis=0) - self._background).max())
            if self._rise > self._lit:
                self._lamp.append((stamp_ns, readings))
            else:
                self._lamp = []

    def verdict(self) -> Verdict:
        """Return what is wrong, and where the lamp is seen from; once it is `complete`."""
        scene, side, wiring = self._scene, self._side, self.wiring
        model, full = ForwardModel(scene), scene.full_scale_counts
        stamps = np.array([stamp for stamp, _ in self._lamp])
        part = stamps >= stamps[-1] - LAMP_S * 1e9
        # Each of shape (images, lamps, detectors).
        dark = np.array([readings for _, readings in self._dark])[..., wiring]
        lamp = np.array([readings for _, readings in self._lamp])[part][..., wiring]
        level, noise, freedoms = dark.mean(axis=0), dark.std(axis=0, ddof=1), len(dark) - 1
        # The daylight, too, has shot noise; a gain is the same in all images.
        sigma = np.sqrt(reading_variance(level, model.own_noise))
        most = MAX_NOISE * sigma * np.sqrt(chdtri(freedoms, FALSE_ALARM) / freedoms)
        middle, steps = float(np.median(level)), np.diff(stamps)
        leaks, bright = np.abs(level - middle) > MAX_LEVEL * full, lamp.mean(axis=0) >= full - 1
        found = {}
        for wrong, text in ((bright, FULL), (noise > most, NOISY), (leaks, LEAKS)):
            for k, i in np.argwhere(wrong).tolist():
                found[divmod(i, side)] = text.format(noise[k, i], sigma[k, i], level[k, i], middle)
        whole, darkness = [], (middle, model.noise.black)
        # Daylight raises darkness, unless the readings are demodulated; nothing lowers it.
        off = middle - model.noise.black
        if -off > MAX_PEDESTAL * model.noise.black or (
            "demodulation" in scene.effects and off > MAX_PEDESTAL * model.noise.black
        ):
            whole.append(PEDESTAL.format(*darkness))
        if steps.max() > 2.5 * np.median(steps):
            whole.append(f"a gap of {steps.max() * 1e-9:.2g} s between images: check line and load")
        light = lamp.mean(axis=0) - level
        if dim := [k for k, each in enumerate(light) if each.max() < self._visible]:
            names = ", ".join(f"lamps[{k}]" for k in dim)
            whole.append(f"{names}: no light: switch it on, or check its channel")
            return Verdict(found, whole, darkness)
        total = lamp.sum(axis=2)
        noisy = reading_variance(lamp.mean(axis=0), model.own_noise).sum(axis=1)
        flickers = np.sqrt(np.maximum(total.var(axis=0) - noisy, 0.0)) / light.sum(axis=1)
        for k in np.flatnonzero(flickers > MAX_FLICKER).tolist():
            name = f"lamps[{k}]" if scene.lamps else "the lamp"
            text = f"{name} flickers by {flickers[k]:.1%}: average whole periods of its driver"
            whole.append(text)
        image = np.clip(np.rint(light) + model.noise.black, 0, full).reshape(-1, side)
        settings = scene.settings()
        settings["prior"] = {"known": "as_bought", "gain_std": SPREAD, "uneven_probability": 0.0}
        if scene.lamps:
            settings["prior"]["roll_std_deg"] = ROLLED_DEG
        placed = scene_from_settings(settings, scene.name)
        try:
            seen = Estimator(placed, max_misfit=MAX_MISFIT).estimate(image)
        except NoPose as reason:
            cure = "detectors that read wrong, a reflection, exchanged lamps, or another beam"
            whole.append(f"the lamp's light is not explained: {reason}: {cure}")
            return Verdict(found, whole, darkness)
        found = {**dict.fromkeys(seen.left_out, UNFIT), **found}
        if abs(rolled := np.degrees(seen.roll)) > MAX_ROLL_DEG:
            whole.append(f"the lamps appear rolled by {rolled:.0f} deg: exchanged, or not level")
        elif text := self._misplaced(seen):
            whole.append(text)
        elif not found:
            found = dict.fromkeys(self._unlike(ForwardModel(placed), image, seen.roll), UNFIT)
        return Verdict(found, whole, darkness, seen)

    def _unlike(self, model: ForwardModel, image: Array, roll: float) -> list[tuple[int, int]]:
        """Return detectors whose light differs from the others', if the lamp is where it is told.

        Of a lamp that may be anywhere, a dim corner looks like a beam that comes from the side.
        """
        prior = model.scene.nuisance_std()
        stds = np.array([*self._by_hand / 2, *prior.values()])
        readings, used = image.ravel(), np.ones(image.size)
        sigma = np.sqrt(reading_variance(readings, model.noise))

        def light(at: Array) -> tuple[Array, Array]:
            values = at * stds
            offsets = {name: np.array(each) for name, each in zip(prior, values[5:], strict=True)}
            counts, slopes = model.linearised(self._told + values[:5], roll, offsets)
            return counts, slopes * stds

        def residuals(at: Array) -> Array:
            return np.append(used * (readings - light(at)[0]) / sigma, at)

        def slopes(at: Array) -> Array:
            return np.vstack([-(used / sigma)[:, None] * light(at)[1], np.eye(len(at))])

        black = model.noise.black
        fit = least_squares(residuals, np.zeros(len(stds)), slopes)
        own = np.einsum("ij,ji->i", fit.jac, np.linalg.pinv(fit.jac))  # by the reading itself
        alone = (fit.fun**2 / np.maximum(1 - own, 1e-9))[: len(readings)]
        worst = int(alone.argmax())
        used[worst] = 0.0
        by_others = light(least_squares(residuals, fit.x, slopes).x)[0][worst] - black
        share = (readings[worst] - black) / max(by_others, float(sigma[worst]))
        if alone[worst] < chdtri(1, UNLIKE) or 1 / MOST < share < MOST:
            return []
        return [divmod(worst % self._side**2, self._side)]

    def _misplaced(self, seen: Estimate) -> str:
        """Say what is wrong where the lamp is seen off its place; empty where it is not."""
        told = self._range_m
        x, y, z, *_ = seen.pose
        text = f"the lamp is seen from x {x:.2f}, y {y:.2f}, z {z:.2f} m, not from x {-told:g}"
        ratio = -x / told
        if max(ratio, 1 / max(ratio, 1e-9)) > MAX_RANGE_RATIO:
            return (
                f"{text}: measure the distance again; if it is right, the light is "
                f"{ratio**-2:.2g} times the scene's: correct lamp.reference_counts, or check "
                "lens and beam"
            )
        off, stds = np.abs(seen.pose - self._told), np.sqrt(np.diag(seen.covariance))
        if (off > self._by_hand + 3 * stds)[1:].any():
            return f"{text}: aim lamp and array at each other, and measure again"
        return ""


def in_air(scene: Scene) -> Scene:
    """Return the scene without water: its beams are wider by refraction at the lamps' flat ports.

    On its axis a lamp is dimmer by the square of the index, and brighter by what the water takes.
    """
    settings = scene.settings()
    for name in ("sea", "attenuation", "forward_scatter", "plume", "ambient"):
        settings["effects"].pop(name, None)
    settings["prior"] = {}
    for lamp in (settings["lamp"], *settings.get("lamps", ())):
        if "beam_sigma_deg" in lamp:
            lamp["beam_sigma_deg"] *= WATER_INDEX
    air = scene_from_settings(settings, scene.name)
    dimmer = ForwardModel(scene).power / ForwardModel(air).power / WATER_INDEX**2
    lamp = dataclasses.replace(air.lamp, reference_counts=dimmer * air.lamp.reference_counts)
    return dataclasses.replace(air, lamp=lamp)
