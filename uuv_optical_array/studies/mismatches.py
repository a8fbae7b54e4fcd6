"""Kinds of mismatch: how what the array sees can differ from what the scene says.

A new kind is a function that returns the light of such a sea, and an entry of `KINDS`. Noise and
electronics are those of the scene; the lamp keeps its power where another setting is off.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.polynomial.legendre import legvander2d

from uuv_optical_array.calibration.aims import appearing
from uuv_optical_array.core.geometry import PITCH, Array, X, Y, Z, rotation_matrix
from uuv_optical_array.forward import prior
from uuv_optical_array.forward.effects import MOVING
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import DAY_S, lit_poses, uniform_poses

Draw: TypeAlias = Callable[[int, np.random.Generator], Array]

# What a calibrated scene leaves open, and up to how many of these sigmas poses should be answered.
SHIPPED, WITHIN = prior.PRIORS["calibrated"], 2.0
NARROWEST_DEG = 0.1  # that a lamp's beam can be
# Products of Legendre polynomials over the array, by their degrees: its smooth uneven modes.
MODES = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
# When modulated lamps are sampled, s; the carriers are as many periods of a frame, and one apart.
FRAME_S, SAMPLES, CARRIER_HZ = 0.1, 3360, 1000.0
TIMES_S = (np.arange(SAMPLES) + 0.5) * FRAME_S / SAMPLES
WAVES_HZ, WAVES_COUNTS = 5.0, 120.0  # of daylight, 30 % of 400 counts


class Sea(NamedTuple):
    """A scene's model, poses ``(n, 5)``, and the source of what differs at random."""

    model: ForwardModel
    poses: Array
    rng: np.random.Generator

    def light(self) -> Array:
        """Return the light of the scene itself, counts, shape ``(n, side, side)``."""
        return self.model.light(self.poses)

    def offset(self, name: str, by: float) -> Array:
        """Return the light where a constant is off, as `ForwardModel.light` has its offsets."""
        return self.model.light(self.poses, 0.0, {name: np.array(by)})

    def lamps_and_rest(self) -> tuple[Array, Array]:
        """Return the light of each lamp, and that of all else, ``(n, L, side, side)``."""
        side, dark = self.model.array.side, self.offset(prior.POWER, -np.inf)
        light, rest = (it.reshape(len(it), -1, side, side) for it in (self.light(), dark))
        return light - rest, rest

    def image(self, lights: Array) -> Array:
        """Return light on the array, ``(n, L or 1, side, side)``, as an image of all lamps."""
        count, _, side, _ = lights.shape
        every = np.broadcast_to(lights, (count, self.model.scene.lamp_count, side, side))
        return every.reshape(count, -1, side)

    def aside(self, port_m: float = 0.0, above_m: float = 0.0) -> Array:
        """Return the light of lamps that are so far from the scene's, ``(n, L, side, side)``."""
        beside = self.poses - np.array([0.0, port_m, above_m, 0.0, 0.0])
        return self._replace(poses=beside).lamps_and_rest()[0]

    def detected(self, signals: Array, carrier_hz: float = CARRIER_HZ) -> Array:
        """Return what each lamp's detection reads of signals at `TIMES_S`, ``(n, L, 1, 1)``."""
        scene = self.model.scene
        waveform, lamps = scene.effects["demodulation"]["waveform"], scene.lamp_count
        if waveform == "slots":
            slots = [modulated(waveform, carrier_hz * TIMES_S, i, lamps) for i in range(lamps + 1)]
            references = (np.array(slots[:-1]) - slots[-1]) / (lamps + 1)
        else:
            carriers_hz = carrier_hz + np.arange(lamps)[:, None] / FRAME_S
            size = 2.0 if waveform == "sine" else np.pi / 2
            references = size * np.sin(2 * np.pi * carriers_hz * TIMES_S)
        return (signals @ references.T / SAMPLES)[..., None, None]


def modulated(waveform: str, turns: Array, i: int, lamps: int) -> Array:
    """Return the light of lamp i, of mean 1, by the phase of its carrier or of the slots, turns."""
    if waveform == "slots":
        return np.where(np.floor(turns % 1 * (lamps + 1)) == i, lamps + 1.0, 0.0)
    sine = np.sin(2 * np.pi * turns)
    return 1 + sine if waveform == "sine" else np.where(sine > 0, 2.0, 0.0)


# Light at the detectors, counts, shape (n, side, side), in a sea that differs `by` so much.


def second_lamp(sea: Sea, by: float, port_m: float = 0.0, above_m: float = 0.0) -> Array:
    """Add another lamp, parallel to the first, of a share of its power."""
    return sea.light() + by * sea.image(sea.aside(port_m, above_m))


def waves(sea: Sea, by: float) -> Array:
    """Add daylight that waves modulate, in each detector its own phase; carriers from `by`, Hz."""
    turns = WAVES_HZ * TIMES_S + np.array([[0.0], [0.25]])
    leak = WAVES_COUNTS * sea.detected(np.sin(2 * np.pi * turns), by)
    side = sea.model.array.side
    phase = sea.rng.uniform(0, 2 * np.pi, (len(sea.poses), 1, side, side))
    return sea.light() + sea.image(np.cos(phase) * leak[0] + np.sin(phase) * leak[1])


def another_leader(sea: Sea, by: float, off_hz: float = 0.0) -> Array:
    """Add another leader's lamps of a share of the power, 0.3 m to port and of a random phase."""
    scene = sea.model.scene
    turns = (CARRIER_HZ + off_hz) * TIMES_S + sea.rng.uniform(size=(len(sea.poses), 1))
    signals = modulated(scene.effects["demodulation"]["waveform"], turns, 0, scene.lamp_count)
    lamp = by * sea.aside(port_m=0.3).sum(axis=1, keepdims=True)
    return sea.light() + sea.image(sea.detected(signals) * lamp)


def late_slots(sea: Sea, by: float) -> Array:
    """Let each lamp light up and go out a share of a slot too late."""
    lamps, rest = sea.lamps_and_rest()
    # A lamp shines into the slot of the next one, and the last one into that for daylight.
    before = np.concatenate([0 * lamps[:, :1], lamps[:, :-1]], axis=1)
    return sea.image((1 - by) * lamps + by * (before - lamps[:, -1:]) + rest)


def one_lamp(sea: Sea, by: float) -> Array:
    """Let one of several lamps, in each frame another, have a share of its power."""
    lamps, rest = sea.lamps_and_rest()
    lamps[np.arange(len(lamps)), sea.rng.integers(lamps.shape[1], size=len(lamps))] *= by
    return sea.image(lamps + rest)


def other_gains(sea: Sea, by: float) -> Array:
    """Give each detector a gain of its own, in each frame another."""
    side = sea.model.array.side
    gains = 1 + by * sea.rng.standard_normal((len(sea.poses), side, side))
    return sea.model.with_gains(sea.light(), np.maximum(gains, 0.0))


def response_power(percent: float) -> float:
    """Return the power of the cosine by which detectors read so much less at 30 deg."""
    return float(np.log(1 - percent / 100) / np.log(np.cos(np.radians(30))))


def one_detector(sea: Sea, full_scales: float) -> Array:
    """Let one detector, in each frame another, read a constant."""
    image = sea.light()
    row, column = sea.rng.integers(sea.model.array.side, size=(2, len(image)))
    image[np.arange(len(image)), row, column] = full_scales * sea.model.scene.full_scale_counts
    return image


def some_detectors(sea: Sea, number: int, gain: float = 1.0, counts: float = 0.0) -> Array:
    """Let some detectors, in each frame others, read a share of their light, or more of it."""
    image = sea.light()
    flat = image.reshape(len(image), -1)
    every = np.tile(np.arange(flat.shape[1]), (len(flat), 1))
    frame, chosen = np.arange(len(flat))[:, None], sea.rng.permuted(every, axis=1)[:, :number]
    flat[frame, chosen] = gain * flat[frame, chosen] + counts
    return image


def two_rows(sea: Sea, gain: float) -> Array:
    """Let two neighbouring rows, in each frame others, read a share of their light."""
    side, count = sea.model.array.side, len(sea.poses)
    first, row = sea.rng.integers(side - 1, size=(count, 1, 1)), np.arange(side)[:, None]
    gains = np.where((row == first) | (row == first + 1), gain, 1.0)
    return sea.model.with_gains(sea.light(), np.broadcast_to(gains, (count, side, side)))


def wider(sea: Sea, by: float) -> Array:
    """Let the array be wider, on the same sphere and under the same lamp."""
    scene = sea.model.scene
    array = dataclasses.replace(scene.array, width_m=by * scene.array.width_m)
    wide = ForwardModel(dataclasses.replace(scene, array=array))
    return sea._replace(model=wide).offset(prior.POWER, np.log(sea.model.power / wide.power))


def turned_lamp(sea: Sea, by: float) -> Array:
    """Turn the lamp to port, deg."""
    aims, bow_m = np.radians([0.0, by, 0.0, 0.0]), sea.model.scene.array.bow_m
    poses, rolls, _ = appearing(sea.poses, np.zeros(len(sea.poses)), aims, bow_m)
    return sea.model.light(poses, rolls)


def turned_mount(sea: Sea, by: float) -> Array:
    """Turn the array about its middle, deg, in each frame in another direction."""
    direction = sea.rng.uniform(0, 2 * np.pi, len(sea.poses))
    aimed = sea.poses.copy()
    aimed[:, PITCH:] += np.radians(by) * np.stack([np.sin(direction), np.cos(direction)], axis=1)
    # Where base_link would be if it turned with the array.
    before, after = (rotation_matrix(*at[:, PITCH:].T)[..., X] for at in (sea.poses, aimed))
    aimed[:, : Z + 1] += sea.model.scene.array.bow_m * (before - after)
    return sea.model.light(aimed)


def shade(sea: Sea, by: float) -> Array:
    """Shade the lamp unevenly and smoothly, the logarithm off by so much over the array, RMS."""
    column, row = prior.over_array(sea.model.array.side)
    modes = np.stack([legvander2d(column, row, degrees)[..., -1] for degrees in MODES])
    modes /= np.sqrt(np.mean(modes**2, axis=(1, 2), keepdims=True))
    depths = sea.rng.standard_normal((len(sea.poses), len(MODES))) * by / np.sqrt(len(MODES))
    lamps, rest = sea.lamps_and_rest()
    return sea.image(lamps * np.exp(np.tensordot(depths, modes, axes=1))[:, None] + rest)


def half_shadow(sea: Sea) -> Array:
    """Let the lamp reach one half of the array, in each frame another, with a hard edge."""
    column, row = prior.over_array(sea.model.array.side)
    turn = sea.rng.uniform(0, 2 * np.pi, (len(sea.poses), 1, 1))
    lamps, rest = sea.lamps_and_rest()
    dark = np.cos(turn) * column + np.sin(turn) * row > 0
    return sea.image(np.where(dark[:, None], 0.0, lamps) + rest)


def blob(sea: Sea) -> Array:
    """Return a Gaussian blob of any place, width and brightness."""
    column, row = prior.over_array(sea.model.array.side)
    count = len(sea.poses)
    at = sea.rng.uniform(-1, 1, (2, count, 1, 1))
    width = sea.rng.uniform(0.3, 1, (2, count, 1, 1))
    peak = sea.rng.uniform(0.1, 1, (count, 1, 1)) * sea.model.scene.full_scale_counts
    squares = ((column - at[0]) / width[0]) ** 2 + ((row - at[1]) / width[1]) ** 2
    return sea.image((peak * np.exp(-squares / 2))[:, None])


def near_poses(count: int, rng: np.random.Generator) -> Array:
    """Draw poses on bearings of the working volume, 2 m behind the lamp."""
    poses = uniform_poses(count, rng)
    poses[:, : Z + 1] *= -2.0 / poses[:, X : X + 1]
    return poses


def aside_poses(count: int, rng: np.random.Generator) -> Array:
    """Draw poses of the working volume, but 1.5 m from the beam's axis."""
    poses = uniform_poses(count, rng)
    poses[:, Y : Z + 1] *= 1.5 / np.linalg.norm(poses[:, Y : Z + 1], axis=1, keepdims=True)
    return poses


# What a kind needs of a scene, by how much it is off, and the same in words.
# fmt: off
NEEDS: dict[str, tuple[Callable[[Scene, float], bool], str]] = {
    "": (lambda scene, by: True, ""),
    # 0.05 less 0.05 is a water that attenuates nothing, whatever rounding says.
    "water": (lambda scene, by: scene.attenuation[1] >= -by - 1e-12,
              "an attenuation of at least {:g} /m"),
    "sea": (lambda scene, by: "sea" in scene.effects, "the effect sea"),
    "sphere": (lambda scene, by: max(by, 1 / by) * scene.array.width_m
               < np.sqrt(2) * (scene.array.radius_m or 0.0),
               "a curved array whose corners stay on the sphere"),
    "all light": (lambda scene, by: "demodulation" not in scene.effects,
                  "readings without demodulation"),
    "modulation": (lambda scene, by: "demodulation" in scene.effects, "the effect demodulation"),
    "slots": (lambda scene, by: scene.effects.get("demodulation", {}).get("waveform") == "slots",
              "the effect demodulation with slots"),
    "lamps": (lambda scene, by: bool(scene.lamps), "several lamps"),
    "beam": (lambda scene, by: scene.lamp.beam_sigma_deg >= NARROWEST_DEG - by,
             "a beam wider than {:g} deg"),
    "motion": (lambda scene, by: bool(MOVING & set(scene.effects)),
               f"one of the effects {', '.join(sorted(MOVING))}"),
}
# fmt: on


@dataclass(frozen=True)
class Kind:
    """A kind of mismatch."""

    name: str  # of ``uuv_array study robustness --kinds``
    what: str  # differs from the scene, a sentence
    cure: str  # what a user does about it, a sentence
    of_sea: Callable[[Sea], Array]
    times_prior: float | None  # off by so many stds of a calibrated prior; None: none is about it
    draw: Draw  # draws the poses
    needs: str  # a key of `NEEDS`
    by: float  # how much it is off

    def light(self, model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
        """Return the light at the detectors, counts, ``(n, side, side)``, at poses ``(n, 5)``."""
        return self.of_sea(Sea(model, poses, rng))

    @property
    def within(self) -> bool:
        """Whether the prior covers it, so that it should be answered with a true covariance."""
        return self.times_prior is not None and self.times_prior <= WITHIN * (1 + 1e-9)

    def missing(self, scene: Scene) -> str:
        """Say what a scene lacks to differ like this; empty where it can."""
        has, what = NEEDS[self.needs]
        if not has(scene, self.by):
            return what.format(-self.by)
        if self.draw is not uniform_poses:
            try:
                lit_poses(ForwardModel(scene), 1, np.random.default_rng(0), self.draw)
            except ValueError:
                return "light at such places"
        return ""


def _kinds(
    name: str,
    light: Callable[..., Array],
    what: str,
    cure: str,
    by: Sequence[float] = (),
    std: str = "",
    off: Callable[[float], float] = abs,
    draw: Draw = uniform_poses,
    needs: str = "",
) -> list[Kind]:
    """Return a kind, or one for each value of `by`; `off` counts it against the prior's `std`."""
    kinds = []
    for value in by or (0.0,):
        words: dict[str, Any] = {"by": value, "size": abs(value), "percent": 100 * value}
        words["more"] = "more" if value > 0 else "less"
        of_sea = partial(light, by=value) if by else light
        times = off(value) / SHIPPED[std] if std else None
        texts = name.format(**words), what.format(**words)
        kinds.append(Kind(*texts, cure, of_sea, times, draw, needs, value))
    return kinds


POWER_CURE = "Calibrate again when lamp or battery change; widen `prior.lamp_power_std`."
K_CURE = "Measure K or calibrate where you dive; widen `prior.k_std_per_m`."
SEA_CURE = K_CURE.replace("K or", "the water or").replace("k_std_per_m", "scattering_std")
BEAM_CURE = "Calibrate the mounted lamp; an ageing diffuser widens the beam."
AMBIENT_CURE = "Measure with the lamp off and set `effects.ambient`, or shield the array."
GRADIENT_CURE = f"{AMBIENT_CURE} A track learns the slope while the range changes."
LAMP_CURE = "Cover or switch off other lamps, or modulate the leader's."
CARRIER_CURE = "Give each leader carriers of its own, at least 50 Hz from all others."
GAIN_CURE = "Calibrate the gains; clean the windows."
FAULT_CURE = "Repair it, or name it in `effects.detector_faults` until then."
SHADE_CURE = "Clean lamp and array; keep hull and cables out of the beam."
ARRAY_CURE = "Calibrate the array as built, and measure its sphere."
SIGNAL_CURE = "Check the array's power, plug and wiring: this is not the lamp's light."

# fmt: off
KINDS = (
    *_kinds("nothing", Sea.light, "The sea is the scene.", "Nothing.", std="lamp_power_std"),
    *_kinds("k{by:+g}", lambda sea, by: sea.offset(sea.model.scene.attenuation[0], by),
            "The water attenuates by {size:g} /m {more}.", K_CURE,
            (-0.05, 0.05, -0.04, 0.04, -0.02, 0.02), "k_std_per_m", needs="water"),
    *_kinds("beam{by:+g}", partial(Sea.offset, name=prior.BEAM_SIGMA),
            "The beam's sigma is {size:g} deg {more}.", BEAM_CURE,
            (-2.0, 2.0, -0.6, 0.6), "beam_sigma_std_deg", needs="beam"),
    *_kinds("power_x{by:g}", lambda sea, by: sea.offset(prior.POWER, np.log(by)),
            "The lamp has {by:g} times its power.", POWER_CURE,
            (0.8, 1.2, 0.5, 2.0), "lamp_power_std", lambda by: abs(by - 1)),
    *_kinds("ambient_{by:g}", lambda sea, by: sea.light() + by,
            "Daylight adds {by:g} counts to every reading.", AMBIENT_CURE,
            (10.0,), "ambient_std_counts", needs="all light"),
    *_kinds("gradient_{by:g}",
            lambda sea, by: sea.light() + np.linspace(0.0, by, sea.model.array.side),
            "Daylight adds 0 counts at the port edge, {by:g} at the starboard edge.",
            GRADIENT_CURE, (10.0, 30.0), needs="all light"),
    *_kinds("second_lamp_{by:g}", partial(second_lamp, port_m=0.3),
            "A second lamp of {percent:g} % of the power is 0.3 m to port of the first.",
            LAMP_CURE, (0.1, 0.3), needs="all light"),
    *_kinds("waves_{by:g}", waves,
            "Waves change 400 counts of daylight by 30 % at 5 Hz; carriers begin at {by:g} Hz.",
            "Modulate the lamps at 1 kHz or faster.", (1000, 40), needs="modulation"),
    *_kinds("same_carrier_{by:g}", another_leader,
            "Another leader's lamp of {percent:g} % of the power, 0.3 m to port, has the carrier "
            "of the first.", CARRIER_CURE, (0.1, 0.3), needs="modulation"),
    *_kinds("other_carrier_{by:g}", partial(another_leader, off_hz=37.0),
            "Another leader's lamp of {percent:g} % of the power, 0.3 m to port, is 37 Hz off the "
            "carrier.", CARRIER_CURE, (0.3,), needs="modulation"),
    *_kinds("late_slots_{by:g}", late_slots,
            "The lamps light up and go out {percent:g} % of a slot late.",
            "Trigger lamps and converter by one clock, or skip the first samples of a slot.",
            (0.01,), needs="slots"),
    *_kinds("one_lamp_x{by:g}", one_lamp, "One of several lamps has {by:g} times its power.",
            "Calibrate the lamps again; clean their windows.", (0.9, 0.7), "lamps_power_std",
            lambda by: 1 - by, needs="lamps"),
    *_kinds("hidden_lamp", partial(one_lamp, by=0.0), "One of several lamps is off or hidden.",
            "Look for `dark lamp` in the diagnostics; keep the lamps clear of the hull.",
            needs="lamps"),
    *_kinds("gains_{by:g}", other_gains, "Each detector's gain is off by {percent:g} %, RMS.",
            GAIN_CURE, (0.005, 0.01, 0.02, 0.03), "gain_std"),
    *_kinds("response-{by:g}",
            lambda sea, by: sea.offset(prior.RESPONSE, response_power(by)),
            "Detectors read {by:g} % less at 30 deg of incidence.", ARRAY_CURE,
            (2, 5), "cosine_power_std", response_power),
    *_kinds("radius_x{by:g}", lambda sea, by: sea.offset(prior.RADIUS, np.log(by)),
            "The array's sphere is 5 % too small.", ARRAY_CURE,
            (0.95,), "radius_std", lambda by: 0.05, needs="sphere"),
    *_kinds("width_x{by:g}", wider, "The array is 5 % wider.", ARRAY_CURE,
            (1.05,), needs="sphere"),
    *_kinds("lamp_axis_{by:g}", turned_lamp, "The lamp points {by:g} deg to port of its frame.",
            "Turn the lamp, or `beacon`, by what `uuv_array calibrate` finds.",
            (2.0,), "lamp_aim_std_deg"),
    *_kinds("scattering_x{by:g}", lambda sea, by: sea.offset(prior.SCATTERING, np.log(by)),
            "The water scatters twice as much.", SEA_CURE,
            (2.0,), "scattering_std", lambda by: float(np.log(by)), needs="sea"),
    *_kinds("two_dirty", partial(some_detectors, number=2, gain=0.8),
            "Two detectors read 0.8 of their light.", FAULT_CURE),
    *_kinds("glint", partial(some_detectors, number=1, counts=50.0),
            "One detector reads 50 counts more.",
            "Shade the array from the surface; such a detector is left out."),
    *_kinds("dead_detector", partial(one_detector, full_scales=0.0),
            "One detector is dead.", FAULT_CURE),
    *_kinds("stuck_detector", partial(one_detector, full_scales=10.0),
            "One detector is stuck at full scale.", FAULT_CURE),
    *_kinds("dark_rows", partial(two_rows, gain=0.0),
            "Two rows are dark.", FAULT_CURE),
    *_kinds("dim_rows", partial(two_rows, gain=0.9),
            "Two rows read 0.9 of their light.", GAIN_CURE),
    *_kinds("shade_{by:g}", shade,
            "An uneven, smooth shade changes the light by {percent:g} %, RMS.",
            SHADE_CURE, (0.02, 0.05, 0.1)),
    *_kinds("half_shadow", half_shadow, "Half of the array lies in a hard shadow.", SHADE_CURE),
    *_kinds("rolled_{by:g}", lambda sea, by: sea.model.light(sea.poses, np.radians(by)),
            "The follower is rolled by {by:g} deg, which one lamp does not show.",
            "Set `use_imu` and connect the vehicle's IMU.", (15.0,)),
    *_kinds("aim_{by:g}", turned_mount, "The array is turned by {by:g} deg on its mount.",
            "Align the array, or calibrate each time after it was taken off.",
            (1.0,), "aim_std_deg"),
    *_kinds("mirrored", lambda sea: sea.light()[..., ::-1],
            "Port and starboard of the image are swapped.",
            "Check the array's wiring: row 0 is the top, column 0 the port edge."),
    *_kinds("reflection", partial(second_lamp, by=0.1, above_m=1.0),
            "The surface, 0.5 m above the lamp, reflects a tenth of its light.",
            "Dive deeper or tilt the lamp down; near a calm surface trust no height."),
    *_kinds("moving", lambda sea: sea.model.light(
                sea.poses, time_s=sea.rng.uniform(0, DAY_S, len(sea.poses))),
            "What moves in the scene moves: plume, flicker, drift.",
            "Wait until the clouds have passed, or go so near that the lamp outshines them.",
            needs="motion"),
    *_kinds("near_2m", Sea.light,
            "The follower is 2 m behind the lamp, nearer than the table; readings saturate.",
            "Extend `table.x_m`, and lower the array's gain.",
            draw=near_poses),
    *_kinds("aside_1.5m", Sea.light,
            "The follower is 1.5 m off the beam's axis, outside of the table.",
            "Extend `table.y_m` and `table.z_m`.",
            draw=aside_poses),
    *_kinds("noise", lambda sea: sea.rng.uniform(
                0, sea.model.scene.full_scale_counts, sea.light().shape),
            "The image is uniform noise.", SIGNAL_CURE),
    *_kinds("blob", blob, "The image is a random Gaussian blob.", SIGNAL_CURE),
)
# fmt: on


def kinds_named(names: str | None, scene: Scene) -> tuple[Kind, ...]:
    """Choose `KINDS` by names between commas; None: all possible. ValueError for any other."""
    if names is None:
        return tuple(kind for kind in KINDS if not kind.missing(scene))
    known, chosen = {kind.name: kind for kind in KINDS}, [name.strip() for name in names.split(",")]
    for name in chosen:
        if name not in known:
            raise ValueError(f"--kinds: {name!r} is unknown; choose of {', '.join(known)}")
        if missing := known[name].missing(scene):
            lacks = f"needs {missing}, which scene {scene.name} has not"
            raise ValueError(f"--kinds: {name} {lacks}; leave it out")
    return tuple(kind for kind in KINDS if kind.name in chosen)
