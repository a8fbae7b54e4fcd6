"""Kinds of mismatch: how what the array sees can differ from what the scene says.

A new kind is a function in `truths` and an entry of `KINDS`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.effects import MOVING
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import PRIORS
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import lit_poses, uniform_poses
from uuv_optical_array.studies.robustness import truths
from uuv_optical_array.studies.robustness.truths import Light

# What a scene that was calibrated once leaves open: standard deviations in the units of the kinds.
SHIPPED = {
    "power": PRIORS["calibrated"]["lamp_power_std"],
    "k_per_m": PRIORS["calibrated"]["k_std_per_m"],
    "beam_deg": PRIORS["calibrated"]["beam_sigma_std_deg"],
    "ambient_counts": PRIORS["calibrated"]["ambient_std_counts"],
    "gains": PRIORS["calibrated"]["gain_std"],
}
# Within so many of these standard deviations poses are to be answered, and honest.
WITHIN = 2.0
NARROWEST_DEG = 0.1  # that a lamp's beam can be


def _always(scene: Scene) -> bool:
    return True


@dataclass(frozen=True)
class Kind:
    """A kind of mismatch.

    Parameters
    ----------
    name
        As ``uuv_array study robustness --kinds`` takes it.
    what
        What differs from the scene, in a sentence.
    cure
        What a user does about it, in a sentence.
    light
        What arrives at the detectors.
    off_by
        By how much of which of `SHIPPED`; empty for what no prior is about.
    draw
        How poses are drawn, as `working_volume.uniform_poses`.
    applies
        Whether a scene can be off like this.
    needs
        What the scene needs for that, where it cannot.
    """

    name: str
    what: str
    cure: str
    light: Light
    off_by: Mapping[str, float] = field(default_factory=dict)
    draw: Callable[[int, np.random.Generator], Array] = uniform_poses
    applies: Callable[[Scene], bool] = _always
    needs: str = ""

    @property
    def times_prior(self) -> float | None:
        """How many shipped standard deviations it is off; None for what no prior is about."""
        return max((off / SHIPPED[name] for name, off in self.off_by.items()), default=None)

    @property
    def within(self) -> bool:
        """Whether an honest estimator answers it and knows how well."""
        times = self.times_prior
        return times is not None and times <= WITHIN * (1 + 1e-9)


POWER_CURE = "Calibrate again when lamp or battery is changed; widen `prior.lamp_power_std`."
K_CURE = "Measure K where the vehicles dive or calibrate there; widen `prior.k_std_per_m`."
BEAM_CURE = "Calibrate the lamp that is mounted; a diffuser that ages widens the beam."
AMBIENT_CURE = "Measure the array with the lamp off and set `effects.ambient`, or shield it."
GRADIENT_CURE = (
    f"{AMBIENT_CURE} In one image a slope looks like a turn of the follower; a track learns it "
    "while the range changes, and poses by what it has learnt are no surer than that."
)
LAMP_CURE = "Cover or switch off other lamps that the array sees, or modulate the leader's."
GAIN_CURE = "Calibrate the gains by `uuv_array calibrate`; clean the windows."
FAULT_CURE = "Repair it, or name it in `effects.detector_faults` until then."
SHADE_CURE = "Clean the port of lamp and array; keep hull and cables out of the beam."
SIGNAL_CURE = "Check power, plug and wiring of the array: this is not light of the lamp."


def _attenuates(least_per_m: float) -> Callable[[Scene], bool]:
    # 0.05 less 0.05 is a water that attenuates nothing, whatever rounding says.
    return lambda scene: truths.attenuation_per_m(scene) >= least_per_m - 1e-12


def _wider(than_deg: float) -> Callable[[Scene], bool]:
    return lambda scene: scene.lamp.beam_sigma_deg >= than_deg + NARROWEST_DEG


def _lit(draw: Callable[[int, np.random.Generator], Array]) -> Callable[[Scene], bool]:
    def applies(scene: Scene) -> bool:
        try:
            lit_poses(ForwardModel(scene), 1, np.random.default_rng(0), draw)
        except ValueError:
            return False
        return True

    return applies


def _attenuations() -> list[Kind]:
    return [
        Kind(
            f"k{off:+g}",
            f"The water attenuates by {abs(off):g} /m {'more' if off > 0 else 'less'}.",
            K_CURE,
            truths.with_attenuation(off),
            {"k_per_m": abs(off)},
            applies=_attenuates(-off),
            needs=f"an attenuation of at least {-off:g} /m",
        )
        for off in (-0.05, 0.05, -0.04, 0.04, -0.02, 0.02)
    ]


def _beams() -> list[Kind]:
    return [
        Kind(
            f"beam{off:+g}",
            f"The beam's standard deviation is {abs(off):g} deg {'more' if off > 0 else 'less'}.",
            BEAM_CURE,
            truths.with_beam(off),
            {"beam_deg": abs(off)},
            applies=_wider(-off),
            needs=f"a beam wider than {-off:g} deg",
        )
        for off in (-2.0, 2.0, -0.6, 0.6)
    ]


def _gradients() -> list[Kind]:
    return [
        Kind(
            f"gradient_{high:g}",
            f"Daylight adds 0 counts at the port edge and {high:g} at the starboard edge.",
            GRADIENT_CURE,
            truths.plus(0.0, high),
        )
        for high in (10.0, 30.0)
    ]


KINDS = (
    Kind("nothing", "The sea is the scene.", "Nothing.", truths.nothing, {"power": 0.0}),
    *_attenuations(),
    *_beams(),
    *(
        Kind(
            f"power_x{factor:g}",
            f"The lamp has {factor:g} times its power.",
            POWER_CURE,
            truths.with_power(factor),
            {"power": abs(factor - 1)},
        )
        for factor in (0.8, 1.2, 0.5, 2.0)
    ),
    Kind(
        "ambient_10",
        "Daylight adds 10 counts to every reading.",
        AMBIENT_CURE,
        truths.plus(10.0, 10.0),
        {"ambient_counts": 10.0},
    ),
    *_gradients(),
    *(
        Kind(
            f"second_lamp_{share:g}",
            f"A second lamp of {100 * share:g} % of the power is 0.3 m to port of the first.",
            LAMP_CURE,
            truths.with_second_lamp(share, truths.SECOND_LAMP_M),
        )
        for share in (0.1, 0.3)
    ),
    *(
        Kind(
            f"gains_{std:g}",
            f"Each detector's gain is off by {100 * std:g} %, RMS.",
            GAIN_CURE,
            truths.with_gains(std),
            {"gains": std},
        )
        for std in (0.005, 0.01, 0.02)
    ),
    Kind("dead_detector", "One detector is dead.", FAULT_CURE, truths.with_detector(False)),
    Kind(
        "stuck_detector",
        "One detector is stuck at full scale.",
        FAULT_CURE,
        truths.with_detector(True),
    ),
    Kind("dark_rows", "Two rows of the array are dark.", FAULT_CURE, truths.with_rows(0.0)),
    Kind(
        "dim_rows",
        "Two rows of the array read 0.9 of their light.",
        GAIN_CURE,
        truths.with_rows(0.9),
    ),
    *(
        Kind(
            f"shade_{std:g}",
            f"An uneven, smooth shade changes the light over the array by {100 * std:g} %, RMS.",
            SHADE_CURE,
            truths.with_shade(std),
        )
        for std in (0.02, 0.05, 0.1)
    ),
    Kind(
        "half_shadow",
        "Half of the array lies in a hard shadow.",
        SHADE_CURE,
        truths.in_half_shadow,
    ),
    Kind(
        "rolled_15",
        "The follower is rolled by 15 deg, and the estimator is not told.",
        "Set `use_imu` and connect the vehicle's IMU.",
        truths.rolled(15.0),
    ),
    Kind(
        "aim_1",
        "The array is turned by 1 deg on its mount.",
        "Align the array on its mount, or calibrate after each time that it was taken off.",
        truths.turned_on_its_mount(1.0),
    ),
    Kind(
        "mirrored",
        "Port and starboard of the image are swapped.",
        "Check the wiring of the array: row 0 is the top, column 0 the port edge.",
        truths.mirrored,
    ),
    Kind(
        "reflection",
        "The surface, 0.5 m above the lamp, reflects a tenth of its light.",
        "Dive deeper or tilt the lamp down; near a calm surface trust no height.",
        truths.with_second_lamp(0.1, truths.MIRRORED_LAMP_M),
    ),
    Kind(
        "moving",
        "What moves in the scene moves: plume, flicker, drift.",
        "Wait until the clouds have passed, or keep a distance at which the lamp outshines them.",
        truths.at_moments,
        applies=lambda scene: bool(MOVING & set(scene.effects)),
        needs=f"one of the effects {', '.join(sorted(MOVING))}",
    ),
    Kind(
        "near_2m",
        "The follower is 2 m behind the lamp, nearer than the table, and readings saturate.",
        "Extend `table.x_m`, and lower the gain of the array for short ranges.",
        truths.nothing,
        draw=truths.near_poses,
        applies=_lit(truths.near_poses),
        needs="light at such places",
    ),
    Kind(
        "aside_1.5m",
        "The follower is 1.5 m off the beam's axis, outside of the table.",
        "Extend `table.y_m` and `table.z_m` to where the vehicle can get.",
        truths.nothing,
        draw=truths.aside_poses,
        applies=_lit(truths.aside_poses),
        needs="light at such places",
    ),
    Kind("noise", "The image is uniform noise.", SIGNAL_CURE, truths.noise),
    Kind("blob", "The image is a random Gaussian blob.", SIGNAL_CURE, truths.blob),
)


def kinds_named(names: str | None, scene: Scene) -> tuple[Kind, ...]:
    """Choose kinds.

    Parameters
    ----------
    names
        Names with commas between them; None: all that the scene can be off by.
    scene
        The scene.

    Returns
    -------
    tuple of Kind
        In the order of `KINDS`.

    Raises
    ------
    ValueError
        For a name that there is not, or a kind that the scene cannot be off by.
    """
    if names is None:
        return tuple(kind for kind in KINDS if kind.applies(scene))
    asked = [name.strip() for name in names.split(",")]
    there = [kind.name for kind in KINDS]
    for name in asked:
        if name not in there:
            raise ValueError(f"kinds: {name!r} is unknown; choose of {', '.join(there)}")
    chosen = tuple(kind for kind in KINDS if kind.name in asked)
    for kind in chosen:
        if not kind.applies(scene):
            raise ValueError(
                f"kinds: {kind.name} needs {kind.needs}, which scene {scene.name} has not; "
                "leave it out"
            )
    return chosen
