"""Kinds of mismatch: how what the array sees can differ from what the scene says.

A new kind is a function that returns the light of such a sea, and an entry of `KINDS`. Noise and
electronics are those of the scene; the lamp keeps its power where another setting is off.
"""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TypeAlias

import numpy as np
from numpy.polynomial.legendre import legvander2d

from uuv_optical_array.core.geometry import PITCH, YAW, Array, X, Y, Z, rotation_matrix
from uuv_optical_array.forward.effects import MOVING, check_effects
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import (
    BEAM_SIGMA,
    POWER,
    PRIORS,
    RADIUS,
    RESPONSE,
    SCATTERING,
    over_array,
)
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import DAY_S, lit_poses, uniform_poses

# Light at the detectors, counts, shape (n, side, side), at poses, shape (n, 5), in the sea that
# differs from the scene of a model; the generator is for what of it is random.
Light: TypeAlias = Callable[[ForwardModel, Array, np.random.Generator], Array]
Draw: TypeAlias = Callable[[int, np.random.Generator], Array]

# What a scene that was calibrated once leaves open: standard deviations in the units of the kinds.
SHIPPED = {
    "power": PRIORS["calibrated"]["lamp_power_std"],
    "k_per_m": PRIORS["calibrated"]["k_std_per_m"],
    "beam_deg": PRIORS["calibrated"]["beam_sigma_std_deg"],
    "ambient_counts": PRIORS["calibrated"]["ambient_std_counts"],
    "gains": PRIORS["calibrated"]["gain_std"],
    "scattering": PRIORS["calibrated"]["scattering_std"],
    "cosine_power": PRIORS["calibrated"]["cosine_power_std"],
    "radius": PRIORS["calibrated"]["radius_std"],
    "aim_deg": PRIORS["calibrated"]["aim_std_deg"],
    "lamp_aim_deg": PRIORS["calibrated"]["lamp_aim_std_deg"],
}
# Up to so many of these standard deviations poses should be answered, with true covariances.
WITHIN = 2.0
NARROWEST_DEG = 0.1  # that a lamp's beam can be
# Products of Legendre polynomials over the array, by their degrees: its smooth uneven modes.
MODES = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
NEAR_M, ASIDE_M = 2.0, 1.5


def unchanged(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
    """Return the light of the scene itself."""
    return model.light(poses)


def with_offset(
    model: ForwardModel, poses: Array, rng: np.random.Generator, of: str, by: float
) -> Array:
    """Add to a constant of the scene, as `ForwardModel.light` has its offsets."""
    return model.light(poses, 0.0, {of: np.array(by)})


def with_attenuation(
    model: ForwardModel, poses: Array, rng: np.random.Generator, by: float
) -> Array:
    """Add to the attenuation, or the absorption, of the scene's water."""
    name, _ = model.scene.attenuation
    if name not in model.nuisances:
        effects = {**model.scene.effects, "attenuation": {"k_per_m": 0.0}}
        model = ForwardModel(dataclasses.replace(model.scene, effects=check_effects(effects)))
    return with_offset(model, poses, rng, name, by)


def daylight(
    model: ForwardModel, poses: Array, rng: np.random.Generator, port: float, starboard: float
) -> Array:
    """Add counts that change evenly from the port edge of the array to its starboard edge."""
    return model.light(poses) + np.linspace(port, starboard, model.array.side)


def lamp_and_rest(model: ForwardModel, poses: Array) -> tuple[Array, Array]:
    """Return the light of the lamp, and that of all else."""
    dark = model.light(poses, 0.0, {POWER: np.array(-np.inf)})
    return model.light(poses) - dark, dark


def second_lamp(
    model: ForwardModel,
    poses: Array,
    rng: np.random.Generator,
    share: float,
    port_m: float = 0.0,
    above_m: float = 0.0,
) -> Array:
    """Add another lamp, parallel to the first, of a share of its power."""
    # The follower's place in the frame of the other lamp.
    beside = poses - np.array([0.0, port_m, above_m, 0.0, 0.0])
    return model.light(poses) + share * lamp_and_rest(model, beside)[0]


def other_gains(model: ForwardModel, poses: Array, rng: np.random.Generator, std: float) -> Array:
    """Give each detector a gain of its own, in each frame another."""
    image = model.light(poses)
    return image * np.maximum(1 + std * rng.standard_normal(image.shape), 0.0)


def one_detector(
    model: ForwardModel, poses: Array, rng: np.random.Generator, full_scales: float
) -> Array:
    """Let one detector, in each frame another, read a constant."""
    image, side = model.light(poses), model.array.side
    row, column = rng.integers(side, size=(2, len(poses)))
    image[np.arange(len(poses)), row, column] = full_scales * model.scene.full_scale_counts
    return image


def some_detectors(
    model: ForwardModel,
    poses: Array,
    rng: np.random.Generator,
    number: int,
    gain: float = 1.0,
    counts: float = 0.0,
) -> Array:
    """Let some detectors, in each frame others, read a share of their light, or more of it."""
    image = model.light(poses)
    flat = image.reshape(len(poses), -1)
    chosen = rng.permuted(np.tile(np.arange(flat.shape[1]), (len(poses), 1)), axis=1)[:, :number]
    frame = np.arange(len(poses))[:, None]
    flat[frame, chosen] = gain * flat[frame, chosen] + counts
    return image


def wider(model: ForwardModel, poses: Array, rng: np.random.Generator, factor: float) -> Array:
    """Let the array be wider, on the same sphere and under the same lamp."""
    array = model.scene.array
    other = dataclasses.replace(array, width_m=factor * array.width_m)
    wide = ForwardModel(dataclasses.replace(model.scene, array=other))
    return wide.light(poses, 0.0, {POWER: np.array(np.log(model.power / wide.power))})


def turned_lamp(
    model: ForwardModel, poses: Array, rng: np.random.Generator, by_deg: float
) -> Array:
    """Turn the lamp to port: what it lights is as if turned to starboard about it."""
    turn, seen = np.radians(by_deg), poses.copy()
    seen[:, X] = np.cos(turn) * poses[:, X] + np.sin(turn) * poses[:, Y]
    seen[:, Y] = np.cos(turn) * poses[:, Y] - np.sin(turn) * poses[:, X]
    seen[:, YAW] -= turn
    return model.light(seen)


def two_rows(model: ForwardModel, poses: Array, rng: np.random.Generator, gain: float) -> Array:
    """Let two neighbouring rows, in each frame others, read a share of their light."""
    image, side = model.light(poses), model.array.side
    first = rng.integers(side - 1, size=(len(poses), 1))
    row = np.arange(side)
    image[(row == first) | (row == first + 1)] *= gain
    return image


def uneven_modes(side: int) -> Array:
    """Return `MODES` over the array, each with an RMS of 1, shape ``(modes, side, side)``."""
    column, row = over_array(side)
    modes = np.stack([legvander2d(column, row, degrees)[..., -1] for degrees in MODES])
    return modes / np.sqrt(np.mean(modes**2, axis=(1, 2), keepdims=True))


def shade(model: ForwardModel, poses: Array, rng: np.random.Generator, std: float) -> Array:
    """Shade the lamp unevenly and smoothly, the logarithm off by `std` over the array, RMS."""
    depths = rng.standard_normal((len(poses), len(MODES))) * std / np.sqrt(len(MODES))
    lamp, rest = lamp_and_rest(model, poses)
    return lamp * np.exp(np.tensordot(depths, uneven_modes(model.array.side), axes=1)) + rest


def half_shadow(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
    """Let the lamp reach one half of the array, in each frame another, with a hard edge."""
    column, row = over_array(model.array.side)
    turn = rng.uniform(0, 2 * np.pi, (len(poses), 1, 1))
    lamp, rest = lamp_and_rest(model, poses)
    return np.where(np.cos(turn) * column + np.sin(turn) * row > 0, 0.0, lamp) + rest


def rolled(model: ForwardModel, poses: Array, rng: np.random.Generator, by_deg: float) -> Array:
    """Roll the follower."""
    return model.light(poses, np.radians(by_deg))


def turned_mount(
    model: ForwardModel, poses: Array, rng: np.random.Generator, by_deg: float
) -> Array:
    """Turn the array about its middle, in each frame in another direction."""
    direction = rng.uniform(0, 2 * np.pi, len(poses))
    aimed = poses.copy()
    aimed[:, PITCH] += np.radians(by_deg) * np.sin(direction)
    aimed[:, YAW] += np.radians(by_deg) * np.cos(direction)
    # Where base_link would be if it turned with the array.
    ahead, aimed_ahead = (rotation_matrix(p[:, PITCH], p[:, YAW])[..., X] for p in (poses, aimed))
    aimed[:, : Z + 1] += model.scene.array.bow_m * (ahead - aimed_ahead)
    return model.light(aimed)


def mirrored(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
    """Swap port and starboard of the image, as a connector the wrong way round does."""
    return model.light(poses)[..., ::-1]


def at_random_times(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
    """Let what moves in the scene move: each image is of a random time of a day."""
    return model.light(poses, time_s=rng.uniform(0, DAY_S, len(poses)))


def noise(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
    """Return readings that are uniform up to full scale."""
    return rng.uniform(0, model.scene.full_scale_counts, model.light(poses).shape)


def blob(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
    """Return a Gaussian blob of any place, width and brightness."""
    column, row = over_array(model.array.side)
    at = rng.uniform(-1, 1, (2, len(poses), 1, 1))
    width = rng.uniform(0.3, 1, (2, len(poses), 1, 1))
    peak = rng.uniform(0.1, 1, (len(poses), 1, 1)) * model.scene.full_scale_counts
    squares = ((column - at[0]) / width[0]) ** 2 + ((row - at[1]) / width[1]) ** 2
    return peak * np.exp(-squares / 2)


def near_poses(count: int, rng: np.random.Generator) -> Array:
    """Draw poses on bearings of the working volume, `NEAR_M` behind the lamp."""
    poses = uniform_poses(count, rng)
    poses[:, : Z + 1] *= -NEAR_M / poses[:, X : X + 1]
    return poses


def aside_poses(count: int, rng: np.random.Generator) -> Array:
    """Draw poses of the working volume, but `ASIDE_M` from the beam's axis."""
    poses = uniform_poses(count, rng)
    across = poses[:, Y : Z + 1]
    across *= ASIDE_M / np.linalg.norm(across, axis=1, keepdims=True)
    return poses


# What a scene needs for a kind that it cannot have; empty where it can.


def needs_water(scene: Scene, least_per_m: float) -> str:
    """Need an attenuation."""
    # 0.05 less 0.05 is a water that attenuates nothing, whatever rounding says.
    enough = scene.attenuation[1] >= least_per_m - 1e-12
    return "" if enough else f"an attenuation of at least {least_per_m:g} /m"


def needs_sea(scene: Scene) -> str:
    """Need water that scatters."""
    return "" if "sea" in scene.effects else "the effect sea"


def needs_sphere(scene: Scene, factor: float) -> str:
    """Need a sphere that carries detectors so much farther out than its own."""
    radius_m = scene.array.radius_m
    holds = radius_m is not None and factor * scene.array.width_m < np.sqrt(2) * radius_m
    return "" if holds else "a curved array whose corners stay on the sphere"


def needs_beam(scene: Scene, than_deg: float) -> str:
    """Need a beam that can be narrower."""
    enough = scene.lamp.beam_sigma_deg >= than_deg + NARROWEST_DEG
    return "" if enough else f"a beam wider than {than_deg:g} deg"


def needs_light(scene: Scene, draw: Draw) -> str:
    """Need light at some of the poses."""
    try:
        lit_poses(ForwardModel(scene), 1, np.random.default_rng(0), draw)
    except ValueError:
        return "light at such places"
    return ""


def needs_motion(scene: Scene) -> str:
    """Need an effect that changes with time."""
    return "" if MOVING & set(scene.effects) else f"one of the effects {', '.join(sorted(MOVING))}"


@dataclass(frozen=True)
class Kind:
    """A kind of mismatch.

    `name` is that of ``uuv_array study robustness --kinds``; `what` differs from the scene, and
    `cure` is what a user does about it, a sentence each. `light` arrives at the detectors, `off_by`
    says by how much of which of `SHIPPED` it is off (empty for what no prior is about), `draw`
    draws the poses, and `missing` says what a scene needs to differ like this, empty where it has
    it.
    """

    name: str
    what: str
    cure: str
    light: Light
    off_by: Mapping[str, float] = field(default_factory=dict)
    draw: Draw = uniform_poses
    missing: Callable[[Scene], str] = lambda scene: ""

    @property
    def times_prior(self) -> float | None:
        """How many shipped standard deviations it is off; None for what no prior is about."""
        return max((off / SHIPPED[name] for name, off in self.off_by.items()), default=None)

    @property
    def within(self) -> bool:
        """Whether the prior covers it, so that it should be answered with a true covariance."""
        times = self.times_prior
        return times is not None and times <= WITHIN * (1 + 1e-9)


POWER_CURE = "Calibrate again when lamp or battery is changed; widen `prior.lamp_power_std`."
K_CURE = "Measure K where the vehicles dive or calibrate there; widen `prior.k_std_per_m`."
BEAM_CURE = "Calibrate the lamp that is mounted; a diffuser that ages widens the beam."
AMBIENT_CURE = "Measure the array with the lamp off and set `effects.ambient`, or shield it."
GRADIENT_CURE = (
    f"{AMBIENT_CURE} In one image a slope looks like a turn of the follower; a track learns it "
    "while the range changes, and its covariance says how well."
)
LAMP_CURE = "Cover or switch off other lamps that the array sees, or modulate the leader's."
GAIN_CURE = "Calibrate the gains by `uuv_array calibrate`; clean the windows."
FAULT_CURE = "Repair it, or name it in `effects.detector_faults` until then."
SHADE_CURE = "Clean the port of lamp and array; keep hull and cables out of the beam."
ARRAY_CURE = "Calibrate the array that was built by `uuv_array calibrate`, and measure its sphere."
SIGNAL_CURE = "Check power, plug and wiring of the array: this is not light of the lamp."


def _more(off: float) -> str:
    return "more" if off > 0 else "less"


KINDS = (
    Kind("nothing", "The sea is the scene.", "Nothing.", unchanged, {"power": 0.0}),
    *(
        Kind(
            f"k{off:+g}",
            f"The water attenuates by {abs(off):g} /m {_more(off)}.",
            K_CURE,
            partial(with_attenuation, by=off),
            {"k_per_m": abs(off)},
            missing=partial(needs_water, least_per_m=-off),
        )
        for off in (-0.05, 0.05, -0.04, 0.04, -0.02, 0.02)
    ),
    *(
        Kind(
            f"beam{off:+g}",
            f"The beam's standard deviation is {abs(off):g} deg {_more(off)}.",
            BEAM_CURE,
            partial(with_offset, of=BEAM_SIGMA, by=off),
            {"beam_deg": abs(off)},
            missing=partial(needs_beam, than_deg=-off),
        )
        for off in (-2.0, 2.0, -0.6, 0.6)
    ),
    *(
        Kind(
            f"power_x{factor:g}",
            f"The lamp has {factor:g} times its power.",
            POWER_CURE,
            partial(with_offset, of=POWER, by=np.log(factor)),
            {"power": abs(factor - 1)},
        )
        for factor in (0.8, 1.2, 0.5, 2.0)
    ),
    Kind(
        "ambient_10",
        "Daylight adds 10 counts to every reading.",
        AMBIENT_CURE,
        partial(daylight, port=10.0, starboard=10.0),
        {"ambient_counts": 10.0},
    ),
    *(
        Kind(
            f"gradient_{high:g}",
            f"Daylight adds 0 counts at the port edge and {high:g} at the starboard edge.",
            GRADIENT_CURE,
            partial(daylight, port=0.0, starboard=high),
        )
        for high in (10.0, 30.0)
    ),
    *(
        Kind(
            f"second_lamp_{share:g}",
            f"A second lamp of {100 * share:g} % of the power is 0.3 m to port of the first.",
            LAMP_CURE,
            partial(second_lamp, share=share, port_m=0.3),
        )
        for share in (0.1, 0.3)
    ),
    *(
        Kind(
            f"gains_{std:g}",
            f"Each detector's gain is off by {100 * std:g} %, RMS.",
            GAIN_CURE,
            partial(other_gains, std=std),
            {"gains": std},
        )
        for std in (0.005, 0.01, 0.02, 0.03)
    ),
    *(
        Kind(
            f"response-{percent}",
            f"Detectors read {percent} % less at 30 deg of incidence.",
            ARRAY_CURE,
            partial(with_offset, of=RESPONSE, by=power),
            {"cosine_power": power},
        )
        for percent in (2, 5)
        for power in [float(np.log(1 - percent / 100) / np.log(np.cos(np.radians(30))))]
    ),
    Kind(
        "radius_x0.95",
        "The sphere of the array is 5 % too small.",
        ARRAY_CURE,
        partial(with_offset, of=RADIUS, by=np.log(0.95)),
        {"radius": 0.05},
        missing=partial(needs_sphere, factor=1 / 0.95),
    ),
    Kind(
        "width_x1.05",
        "The array is 5 % wider than the scene says.",
        ARRAY_CURE,
        partial(wider, factor=1.05),
        missing=partial(needs_sphere, factor=1.05),
    ),
    Kind(
        "lamp_axis_2",
        "The lamp points 2 deg to port of its frame.",
        "Turn the lamp, or the frame `beacon`, by what `uuv_array calibrate` finds.",
        partial(turned_lamp, by_deg=2.0),
        {"lamp_aim_deg": 2.0},
    ),
    Kind(
        "scattering_x2",
        "The water scatters twice as much.",
        K_CURE.replace("K where", "the water where").replace("k_std_per_m", "scattering_std"),
        partial(with_offset, of=SCATTERING, by=np.log(2.0)),
        {"scattering": float(np.log(2.0))},
        missing=needs_sea,
    ),
    Kind(
        "two_dirty",
        "Two detectors read 0.8 of their light.",
        FAULT_CURE,
        partial(some_detectors, number=2, gain=0.8),
    ),
    Kind(
        "glint",
        "One detector reads 50 counts more.",
        "Shade the array from the surface; the estimator leaves such a detector out.",
        partial(some_detectors, number=1, counts=50.0),
    ),
    *(
        Kind(f"{name}_detector", what, FAULT_CURE, partial(one_detector, full_scales=full_scales))
        for name, what, full_scales in (
            ("dead", "One detector is dead.", 0.0),
            ("stuck", "One detector is stuck at full scale.", 10.0),
        )
    ),
    Kind("dark_rows", "Two rows of the array are dark.", FAULT_CURE, partial(two_rows, gain=0.0)),
    Kind(
        "dim_rows",
        "Two rows of the array read 0.9 of their light.",
        GAIN_CURE,
        partial(two_rows, gain=0.9),
    ),
    *(
        Kind(
            f"shade_{std:g}",
            f"An uneven, smooth shade changes the light over the array by {100 * std:g} %, RMS.",
            SHADE_CURE,
            partial(shade, std=std),
        )
        for std in (0.02, 0.05, 0.1)
    ),
    Kind("half_shadow", "Half of the array lies in a hard shadow.", SHADE_CURE, half_shadow),
    Kind(
        "rolled_15",
        "The follower is rolled by 15 deg, and the estimator is not told.",
        "Set `use_imu` and connect the vehicle's IMU.",
        partial(rolled, by_deg=15.0),
    ),
    Kind(
        "aim_1",
        "The array is turned by 1 deg on its mount.",
        "Align the array on its mount, or calibrate after each time that it was taken off.",
        partial(turned_mount, by_deg=1.0),
        {"aim_deg": 1.0},
    ),
    Kind(
        "mirrored",
        "Port and starboard of the image are swapped.",
        "Check the wiring of the array: row 0 is the top, column 0 the port edge.",
        mirrored,
    ),
    Kind(
        "reflection",
        "The surface, 0.5 m above the lamp, reflects a tenth of its light.",
        "Dive deeper or tilt the lamp down; near a calm surface trust no height.",
        partial(second_lamp, share=0.1, above_m=1.0),
    ),
    Kind(
        "moving",
        "What moves in the scene moves: plume, flicker, drift.",
        "Wait until the clouds have passed, or keep a distance at which the lamp outshines them.",
        at_random_times,
        missing=needs_motion,
    ),
    Kind(
        "near_2m",
        "The follower is 2 m behind the lamp, nearer than the table, and readings saturate.",
        "Extend `table.x_m`, and lower the gain of the array for short ranges.",
        unchanged,
        draw=near_poses,
        missing=partial(needs_light, draw=near_poses),
    ),
    Kind(
        "aside_1.5m",
        "The follower is 1.5 m off the beam's axis, outside of the table.",
        "Extend `table.y_m` and `table.z_m` to where the vehicle can get.",
        unchanged,
        draw=aside_poses,
        missing=partial(needs_light, draw=aside_poses),
    ),
    Kind("noise", "The image is uniform noise.", SIGNAL_CURE, noise),
    Kind("blob", "The image is a random Gaussian blob.", SIGNAL_CURE, blob),
)


def kinds_named(names: str | None, scene: Scene) -> tuple[Kind, ...]:
    """Choose kinds by their names with commas between them; None: all that the scene can have.

    They are in the order of `KINDS`. A ValueError names an unknown one, or one that the scene
    cannot have.
    """
    if names is None:
        return tuple(kind for kind in KINDS if not kind.missing(scene))
    chosen = [name.strip() for name in names.split(",")]
    known = [kind.name for kind in KINDS]
    for name in chosen:
        if name not in known:
            raise ValueError(f"--kinds: {name!r} is unknown; choose of {', '.join(known)}")
    kinds = tuple(kind for kind in KINDS if kind.name in chosen)
    for kind in kinds:
        if missing := kind.missing(scene):
            raise ValueError(
                f"--kinds: {kind.name} needs {missing}, which scene {scene.name} has not; "
                "leave it out"
            )
    return kinds
