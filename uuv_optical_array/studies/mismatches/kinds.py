"""Kinds of mismatch, and what a user does about each.

A new kind is a function of `seas` that returns the light of such a sea, and an entry of `KINDS`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from uuv_optical_array.core.geometry import Array, X, Y, Z
from uuv_optical_array.forward import prior
from uuv_optical_array.forward.effects import MOVING
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import DAY_S, lit_poses, uniform_poses
from uuv_optical_array.studies.mismatches import seas
from uuv_optical_array.studies.mismatches.seas import Sea

Draw: TypeAlias = Callable[[int, np.random.Generator], Array]

# What a calibrated scene leaves open, and up to how many of these sigmas poses should be answered.
SHIPPED, WITHIN = prior.PRIORS["calibrated"], 2.0
NARROWEST_DEG = 0.1  # that a lamp's beam can be


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
    "Gaussian": (lambda scene, by: not scene.lamp.beam_widths, "a beam of one Gaussian"),
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
WATER_CURE = "Measure the water or calibrate where you dive; widen"
K_CURE = f"{WATER_CURE} `prior.k_std_per_m`, or with the effect `sea` `prior.absorption_std_per_m`."
SEA_CURE = f"{WATER_CURE} `prior.scattering_std`."
BEAM_CURE = "Calibrate the mounted lamp."
SHAPE_CURE = "Name the lamp's file in `lamp.photometry`, or calibrate with a `beam_shape_std`."
AMBIENT_CURE = "Measure with the lamp off and set `effects.ambient`, or shield the array."
GRADIENT_CURE = (
    "Shield the array, or widen `prior.ambient_gradient_std_counts`. A track may learn the slope "
    "while the range changes."
)
LAMP_CURE = "Cover or switch off other lamps, or modulate the leader's."
CARRIER_CURE = "Give each leader its own carriers, at least 100 Hz from all others."
GAIN_CURE = "Calibrate the gains; clean the windows."
FAULT_CURE = "Repair it, or name it in `effects.detector_faults` until then."
SHADE_CURE = "Clean lamp and array; keep hull and cables out of the beam."
ARRAY_CURE = "Measure width and sphere of the array as built, and calibrate it."
SIGNAL_CURE = "Check the array's power, plug and wiring: this is not the lamp's light."

# fmt: off
KINDS = (
    *_kinds("nothing", Sea.light, "The sea is as the scene says.", "Nothing.",
            std="lamp_power_std"),
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
    *_kinds("second_lamp_{by:g}", partial(seas.second_lamp, port_m=0.3),
            "A second lamp of {percent:g} % of the power is 0.3 m to port of the first.",
            LAMP_CURE, (0.1, 0.3), needs="all light"),
    *_kinds("waves_{by:g}", seas.waves,
            "Waves change 400 counts of daylight by 30 % at 5 Hz; carriers begin at {by:g} Hz.",
            "Modulate the lamps at 1 kHz or faster.", (1000, 40), needs="modulation"),
    *_kinds("same_carrier_{by:g}", seas.another_leader,
            "Another leader's lamp of {percent:g} % of the power, 0.3 m to port, has the carrier "
            "of the first.", CARRIER_CURE, (0.1, 0.3), needs="modulation"),
    *_kinds("other_carrier_{by:g}", partial(seas.another_leader, off_hz=37.0),
            "Another leader's lamp of {percent:g} % of the power, 0.3 m to port, is 37 Hz off the "
            "carrier.", CARRIER_CURE, (0.3,), needs="modulation"),
    *_kinds("late_slots_{by:g}", seas.late_slots,
            "The lamps light up and go out {percent:g} % of a slot late.",
            "Trigger lamps and converter by one clock, or skip the first samples of a slot.",
            (0.01,), needs="slots"),
    *_kinds("one_lamp_x{by:g}", seas.one_lamp, "One of several lamps has {by:g} times its power.",
            "Calibrate the lamps again; clean their windows.", (0.9, 0.7), "lamps_power_std",
            lambda by: 1 - by, needs="lamps"),
    *_kinds("hidden_lamp", partial(seas.one_lamp, by=0.0), "One of several lamps is off or hidden.",
            "Look for `dark lamp` in the diagnostics; keep the lamps clear of the hull.",
            needs="lamps"),
    *_kinds("gains_{by:g}", seas.other_gains, "Each detector's gain is off by {percent:g} %, RMS.",
            GAIN_CURE, (0.005, 0.01, 0.02, 0.03), "gain_std"),
    *_kinds("response-{by:g}",
            lambda sea, by: sea.offset(prior.RESPONSE, seas.response_power(by)),
            "Detectors read {by:g} % less at 30 deg of incidence.", ARRAY_CURE,
            (2, 5), "cosine_power_std", seas.response_power),
    *_kinds("radius_x{by:g}", lambda sea, by: sea.offset(prior.RADIUS, np.log(by)),
            "The array's sphere is 5 % too small.", ARRAY_CURE,
            (0.95,), "radius_std", lambda by: 0.05, needs="sphere"),
    *_kinds("width_x{by:g}", seas.wider, "The array is 5 % wider.", ARRAY_CURE,
            (1.05,), needs="sphere"),
    *_kinds("lamp_axis_{by:g}", seas.turned_lamp,
            "The lamp's beam points {by:g} deg to starboard of its frame's -x.",
            "Turn the lamp back, or `beacon`, by what `uuv_array calibrate` finds.",
            (2.0,), "lamp_aim_std_deg"),
    *_kinds("scattering_x{by:g}", lambda sea, by: sea.offset(prior.SCATTERING, np.log(by)),
            "The water scatters twice as much.", SEA_CURE,
            (2.0,), "scattering_std", lambda by: float(np.log(by)), needs="sea"),
    *_kinds("two_dirty", partial(seas.some_detectors, number=2, gain=0.8),
            "Two detectors read 0.8 of what they would.", FAULT_CURE),
    *_kinds("glint", partial(seas.some_detectors, number=1, counts=50.0),
            "One detector reads 50 counts more.",
            "Shade the array from the surface."),
    *_kinds("dead_detector", partial(seas.one_detector, full_scales=0.0),
            "One detector is dead.", FAULT_CURE),
    *_kinds("stuck_detector", partial(seas.one_detector, full_scales=10.0),
            "One detector is stuck at full scale.", FAULT_CURE),
    *_kinds("dark_rows", partial(seas.two_rows, gain=0.0),
            "Two rows are dark.", FAULT_CURE),
    *_kinds("dim_rows", partial(seas.two_rows, gain=0.9),
            "Two rows read 0.9 of their light.", GAIN_CURE),
    *_kinds("shade_{by:g}", seas.shade,
            "An uneven, smooth shade changes the light by {percent:g} %, RMS.",
            SHADE_CURE, (0.02, 0.05, 0.1)),
    *_kinds("half_shadow", seas.half_shadow, "Half of the array lies in a hard shadow.",
            SHADE_CURE),
    *_kinds("hidden_row_{by:g}", seas.hidden_row,
            "The lowest row sees {by:g} of the lamp, behind the hull.", SHADE_CURE, (0.5,)),
    *_kinds("fouled_{by:g}", seas.fouled,
            "Fouling takes {percent:g} % of the light at one edge of the array.",
            SHADE_CURE, (0.3, 0.6)),
    *_kinds("bubble_{by:g}", seas.bubble, "A bubble takes up to {percent:g} % of detectors' light.",
            "Wipe the window; purge the air before the dive.", (0.3,)),
    *_kinds("snow", partial(seas.some_detectors, number=3, gain=0.7),
            "Flakes of marine snow take 30 % of what three detectors read.",
            "Wait until they have passed."),
    *_kinds("moffat", seas.moffat_lobe,
            "The beam is a Moffat lobe, with wider flanks, as wide at half of its peak.",
            SHAPE_CURE, needs="Gaussian"),
    *_kinds("ring_{by:g}", seas.ring, "A ring in the beam is {percent:g} % brighter.",
            SHAPE_CURE, (0.03,)),
    *_kinds("cut_off", seas.cut_off, "The leader's hull cuts off the beam to port.",
            "Mount the lamp clear of the hull."),
    *_kinds("bent_{by:g}", seas.bent,
            "The converter is bent, S-shaped, by {percent:g} % of its full scale.",
            "Calibrate the converter against a divider.", (0.01,)),
    *_kinds("rolled_{by:g}", lambda sea, by: sea.model.light(sea.poses, np.radians(by)),
            "The follower is rolled by {by:g} deg, which one lamp does not show.",
            "Set `use_imu` and connect the vehicle's IMU.", (15.0,)),
    *_kinds("aim_{by:g}", seas.turned_mount, "The array is turned by {by:g} deg on its mount.",
            "Align the array, or calibrate each time after it was taken off.",
            (1.0,), "aim_std_deg"),
    *_kinds("mirrored", lambda sea: sea.light()[..., ::-1],
            "Port and starboard of the image are swapped.",
            "Check the array's wiring: row 0 is the top, column 0 the port edge."),
    *_kinds("reflection", partial(seas.second_lamp, by=0.1, above_m=1.0),
            "The surface, 0.5 m above the lamp, reflects a tenth of its light.",
            "Dive deeper or tilt the lamp down; do not trust the height near a calm surface."),
    *_kinds("moving", lambda sea: sea.model.light(
                sea.poses, time_s=sea.rng.uniform(0, DAY_S, len(sea.poses))),
            "Clouds move, and the lamp flickers and drifts, as the scene has it.",
            "Wait until the clouds have passed, or go nearer.",
            needs="motion"),
    *_kinds("near_2m", Sea.light,
            "The follower is 2 m behind the lamp.",
            "Extend `table.x_m`, and lower the array's gain.",
            draw=near_poses),
    *_kinds("aside_1.5m", Sea.light,
            "The follower is 1.5 m off the beam's axis.",
            "Extend `table.y_m` and `table.z_m`.",
            draw=aside_poses),
    *_kinds("noise", lambda sea: sea.rng.uniform(
                0, sea.model.scene.full_scale_counts, sea.light().shape),
            "The image is uniform noise.", SIGNAL_CURE),
    *_kinds("blob", seas.blob, "The image is a random Gaussian blob.", SIGNAL_CURE),
)
# fmt: on


def kinds_named(names: str | None, scene: Scene) -> tuple[Kind, ...]:
    """Choose `KINDS` by names between commas; None: all possible. ValueError for any other."""
    if names is None:
        return tuple(kind for kind in KINDS if not kind.missing(scene))
    known, chosen = {kind.name: kind for kind in KINDS}, [name.strip() for name in names.split(",")]
    for name in chosen:
        if name not in known:
            raise ValueError(f"--kinds: {name!r} is unknown; choose from {', '.join(known)}")
        if missing := known[name].missing(scene):
            lacks = f"needs {missing}, which scene {scene.name} has not"
            raise ValueError(f"--kinds: {name} {lacks}; leave it out")
    return tuple(kind for kind in KINDS if kind.name in chosen)
