"""What array and lamp to build: designs, the scene of each, and the scores they get.

A design is scored by the two criteria of Eren et al. (2016), whether the signature tells 0.2 m and
10 deg apart 4 to 8 m behind the lamp and how many detectors that takes, and by the Cramer-Rao bound
over the working volume. docs/design_study.md says what each score means.
"""

import dataclasses
import itertools
import math
import typing
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np

from uuv_optical_array.accuracy import HIGH, LOW, MIN_PEAK_COUNTS, within_volume
from uuv_optical_array.array import ArraySettings, Shape
from uuv_optical_array.image import ForwardModel
from uuv_optical_array.light import LampSettings, beam_solid_angle
from uuv_optical_array.limits import cramer_rao_bound
from uuv_optical_array.paper import (
    RANGES_M,
    THRESHOLD_DEG,
    Conditions,
    Motion,
    angles_deg,
    from_paper_axes,
    scene_signature,
)
from uuv_optical_array.pose import Array
from uuv_optical_array.quantity import Quantity, check
from uuv_optical_array.sam import spectral_angle
from uuv_optical_array.scene import Scene
from uuv_optical_array.tradeoff import position_and_angle

# How bright each design's lamp is; `designed` explains.
Power: TypeAlias = Literal["flux", "fixed_gain", "counts"]
Mount: TypeAlias = Literal["front", "centre"]

# What the specification wants told apart: m and deg, to either side.
MOVES: dict[Motion, tuple[float, float]] = {"shift": (0.2, -0.2), "yaw": (10.0, -10.0)}
NOISE_DRAWS = 64
BLOCK_READINGS = 1 << 14  # worked on at a time, which bounds the memory
# Settings that are a reading of the light, or its inverse, and so change with the gain.
WITH_GAIN = {("ambient", "level_counts"): 1, ("ambient", "surface_counts"): 1}
WITH_GAIN |= {("shot_noise", "electrons_per_count"): -1, ("photodiode", "amps_per_count"): -1}
WITH_GAIN |= {("photodiode", "watts_per_m2_per_count"): -1}


@dataclass(frozen=True)
class Design:
    """An array and a lamp.

    Parameters
    ----------
    shape, detectors_per_side, width_m, radius_m
        As in `ArraySettings`.
    beam_sigma_deg
        Standard deviation of the lamp's beam, deg.
    """

    shape: Shape
    detectors_per_side: int
    width_m: float
    radius_m: float | None
    beam_sigma_deg: float

    @classmethod
    def of(cls, scene: Scene) -> "Design":
        """Return the design that a scene has."""
        array = scene.array
        return cls(
            array.shape,
            array.detectors_per_side,
            array.width_m,
            array.radius_m,
            scene.lamp.beam_sigma_deg,
        )

    @property
    def detectors(self) -> int:
        """How many there are."""
        return self.detectors_per_side**2

    @property
    def label(self) -> str:
        """The design in words."""
        side, sphere = self.detectors_per_side, "" if self.radius_m is None else self.radius_m
        radius = f", radius {sphere:g} m" if sphere else ""
        return (
            f"{self.shape} {side} x {side}, {self.width_m:g} m{radius}, "
            f"beam {self.beam_sigma_deg:g} deg"
        )


_HINTS = {
    **typing.get_type_hints(ArraySettings, include_extras=True),
    **typing.get_type_hints(LampSettings, include_extras=True),
    "radius_m": Annotated[float, Quantity("sphere, curved only", "m", 0.01, 100)],
}


@dataclass(frozen=True)
class Sweep:
    """A grid of designs, without those that cannot be built.

    Parameters
    ----------
    shape, detectors_per_side, width_m, radius_m, beam_sigma_deg
        Values of each, all different; a radius is for curved arrays alone.

    Raises
    ------
    ValueError
        For an empty list, a value that is given twice or out of bounds, or where nothing is left.
    """

    shape: Sequence[Shape]
    detectors_per_side: Sequence[int]
    width_m: Sequence[float]
    radius_m: Sequence[float]
    beam_sigma_deg: Sequence[float]

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            values = [check(_HINTS[field.name], v, field.name) for v in getattr(self, field.name)]
            if not values and (field.name != "radius_m" or "curved" in self.shape):
                raise ValueError(f"{field.name}: no value; give at least one")
            for value in values:
                if values.count(value) > 1:
                    raise ValueError(f"{field.name}: {value} is given twice; give it once")
            object.__setattr__(self, field.name, tuple(values))
        if not self.designs():
            reasons = "; ".join(self.dropped())
            raise ValueError(f"radius_m: no design is left ({reasons}); give a larger one")

    def designs(self) -> list[Design]:
        """List what can be built, the number of detectors changing fastest."""
        return [design for design in self._grid() if _fault(design) is None]

    def dropped(self) -> dict[str, int]:
        """Count what cannot be built, by the reason."""
        found: dict[str, int] = {}
        for fault in filter(None, map(_fault, self._grid())):
            found[fault] = found.get(fault, 0) + 1
        return found

    def as_object(self) -> dict[str, list[Any]]:
        """Return the lists as plain values."""
        return {name: list(values) for name, values in vars(self).items()}

    def _grid(self) -> list[Design]:
        return [
            Design(shape, side, width_m, radius_m, sigma_deg)
            for shape in self.shape
            for radius_m, width_m, sigma_deg, side in itertools.product(
                self.radius_m if shape == "curved" else (None,),
                self.width_m,
                self.beam_sigma_deg,
                self.detectors_per_side,
            )
        ]


def _fault(design: Design) -> str | None:
    """Say why a design cannot be built, alike for all that share the reason."""
    try:
        ArraySettings(design.shape, 2, design.width_m, 0.0, design.radius_m)
    except ValueError:
        return f"{design.width_m:g} m wide on a sphere of {design.radius_m:g} m: corners beyond it"
    return None


def designed(scene: Scene, design: Design, power: Power = "flux", mount: Mount = "front") -> Scene:
    """Return a scene with another array and lamp, and the lamp's power set.

    Parameters
    ----------
    scene
        The scene, whose own array and lamp are the reference.
    design
        What takes their place.
    power
        ``flux``: the lamp emits as much light as the scene's, into a beam of another width. Where
        the aligned array would read more of it at the reference range than the scene's does, the
        gain of the electronics is turned down until it reads the same; noise behind the gain stays
        as it is in counts. ``fixed_gain``: the same light, but the gain stays, and the array
        saturates. ``counts``: the lamp is as strong as it takes for the same reading.
    mount
        ``front``: the foremost point of the array stays where the scene's is. ``centre``: the
        frame of the array does, which is the centre of a sphere, as Eren et al. (2016) have it.

    Returns
    -------
    Scene
        A scene like any other.

    Raises
    ------
    ValueError
        For an array that cannot be built, or that gets no light at the reference range.
    """
    bow_m = scene.array.bow_m
    if mount == "front":
        bow_m += (scene.array.radius_m or 0.0) - (design.radius_m or 0.0)
    array = ArraySettings(
        design.shape, design.detectors_per_side, design.width_m, bow_m, design.radius_m
    )
    lamp = dataclasses.replace(scene.lamp, beam_sigma_deg=design.beam_sigma_deg)
    found = dataclasses.replace(scene, array=array, lamp=lamp)
    if power == "counts" or design == Design.of(scene):
        return found
    solid_angle = beam_solid_angle(math.radians(design.beam_sigma_deg))
    base_flux = ForwardModel(scene).power * beam_solid_angle(
        math.radians(scene.lamp.beam_sigma_deg)
    )
    brighter = base_flux / solid_angle / ForwardModel(found).power
    if power == "flux" and brighter > 1:
        return with_gain(found, 1 / brighter)
    lamp = dataclasses.replace(lamp, reference_counts=brighter * lamp.reference_counts)
    return dataclasses.replace(found, lamp=lamp)


def with_gain(scene: Scene, gain: float) -> Scene:
    """Return a scene whose electronics give `gain` times the counts for the same light.

    The lamp's `reference_counts` are not touched: they say how strong the lamp is after the change.
    """
    effects = {
        name: {
            key: value * gain ** WITH_GAIN[name, key]
            if (name, key) in WITH_GAIN and value is not None
            else value
            for key, value in settings.items()
        }
        for name, settings in scene.effects.items()
    }
    prior = dataclasses.replace(
        scene.prior, ambient_std_counts=gain * scene.prior.ambient_std_counts
    )
    return dataclasses.replace(scene, effects=effects, prior=prior)


@dataclass(frozen=True)
class Score:
    """What a design is worth.

    Parameters
    ----------
    reference_counts
        Largest reading of the lamp by the aligned array at the scene's reference range.
    shift_near_deg, yaw_near_deg
        Spectral angle of the paper's signature for 0.2 m across and for 10 deg of yaw, of either
        side the smaller one, 4 m behind the lamp, deg; nan where the aligned image is flat.
    shift_deg, yaw_deg
        The least of that at 4, 5, 6, 7 and 8 m.
    shift_near_sigmas, yaw_near_sigmas, shift_sigmas, yaw_sigmas
        The same angles over the root mean square angle by which noise moves the signature of the
        aligned array there; inf where noise moves nothing.
    position_m, angle_deg
        Root mean square bound over the working volume, that volume known: see
        `accuracy.within_volume`. Never more than what is known without any light.
    lit
        Share of the volume where the image peaks above `accuracy.MIN_PEAK_COUNTS`.
    lit_position_m, lit_angle_deg
        Root mean square Cramer-Rao bound of the image alone over that share; nan where it is
        nothing, inf where a pose in it is unobservable.
    """

    reference_counts: float
    shift_near_deg: float
    yaw_near_deg: float
    shift_deg: float
    yaw_deg: float
    shift_near_sigmas: float
    yaw_near_sigmas: float
    shift_sigmas: float
    yaw_sigmas: float
    position_m: float
    angle_deg: float
    lit: float
    lit_position_m: float
    lit_angle_deg: float

    @property
    def told_near(self) -> bool:
        """Whether both moves reach the paper's threshold at 4 m, which is where it decides."""
        return min(self.shift_near_deg, self.yaw_near_deg) >= THRESHOLD_DEG

    @property
    def told(self) -> bool:
        """Whether they do from 4 to 8 m, which is what it claims."""
        return min(self.shift_deg, self.yaw_deg) >= THRESHOLD_DEG


def volume_poses(count: int, rng: np.random.Generator) -> Array:
    """Draw poses uniformly from the working volume, m and rad, shape ``(count, 5)``."""
    return rng.uniform(LOW, HIGH, (count, 5))


def score(scene: Scene, poses: Array, rng: np.random.Generator) -> Score:
    """Score the array and lamp of a scene.

    Parameters
    ----------
    scene
        The scene, such as `designed` returns.
    poses
        Where the bound is taken, the same for designs that are compared, shape ``(n, 5)``, n >= 1.
    rng
        Of the noise.

    Returns
    -------
    Score
        Its scores.
    """
    model = ForwardModel(scene)
    shift, yaw = (separations(scene, motion) for motion in MOVES)
    noise = np.array([signature_noise_deg(model, range_m, rng) for range_m in RANGES_M])
    with np.errstate(divide="ignore", invalid="ignore"):
        shift_sigmas, yaw_sigmas = shift / noise, yaw / noise
    known, alone, lit = bounds(model, poses)
    position_m, angle_deg = position_and_angle(known)
    lit_position_m, lit_angle_deg = position_and_angle(alone[lit])
    return Score(
        reference_counts=scene.lamp.reference_counts,
        shift_near_deg=float(shift[0]),
        yaw_near_deg=float(yaw[0]),
        shift_deg=float(shift.min()),
        yaw_deg=float(yaw.min()),
        shift_near_sigmas=float(shift_sigmas[0]),
        yaw_near_sigmas=float(yaw_sigmas[0]),
        shift_sigmas=float(shift_sigmas.min()),
        yaw_sigmas=float(yaw_sigmas.min()),
        position_m=position_m,
        angle_deg=angle_deg,
        lit=float(lit.mean()),
        lit_position_m=lit_position_m,
        lit_angle_deg=lit_angle_deg,
    )


def separations(scene: Scene, motion: Motion) -> Array:
    """Return the spectral angle of a move of `MOVES` at each of `RANGES_M`, deg, shape ``(5,)``."""
    array = scene.array
    return np.array(
        [
            angles_deg(
                scene,
                Conditions(array.shape, array.detectors_per_side, range_m, motion),
                MOVES[motion],
            ).min()
            for range_m in RANGES_M
        ]
    )


def signature_noise_deg(model: ForwardModel, range_m: float, rng: np.random.Generator) -> float:
    """Return by what angle noise moves the aligned array's signature, deg, root mean square.

    Parameters
    ----------
    model
        Of the scene.
    range_m
        Of ``base_link`` behind the lamp, m.
    rng
        Of the noise.

    Returns
    -------
    float
        Over `NOISE_DRAWS` readings, from the signature of the image without noise.
    """
    pose = from_paper_axes([range_m, 0, 0, 0, 0])
    clean = model.expected(pose)
    on_axis_counts = float(clean.max())
    calm = scene_signature(clean, on_axis_counts, model.scene)
    step = _block(model)
    squares = 0.0
    for start in range(0, NOISE_DRAWS, step):
        count = min(step, NOISE_DRAWS - start)
        readings = model.expose(np.broadcast_to(pose, (count, 5)), rng)
        angles = spectral_angle(calm, scene_signature(readings, on_axis_counts, model.scene))
        squares += float((angles**2).sum())
    return math.degrees(math.sqrt(squares / NOISE_DRAWS))


def bounds(model: ForwardModel, poses: Array) -> tuple[Array, Array, Array]:
    """Bound the errors at poses.

    Returns
    -------
    known : Array
        Least standard deviation, the volume known, m and rad, shape ``(n, 5)``.
    alone : Array
        That of the image alone, the Cramer-Rao bound.
    lit : ndarray of bool
        Whether there is light, shape ``(n,)``.
    """
    known, alone, lit = np.empty_like(poses), np.empty_like(poses), np.empty(len(poses), bool)
    step = _block(model)
    for start in range(0, len(poses), step):
        part = slice(start, start + step)
        bound = cramer_rao_bound(model, poses[part])
        known[part], alone[part] = within_volume(bound.information), bound.std
        lit[part] = model.expected(poses[part]).max(axis=(-2, -1)) > MIN_PEAK_COUNTS
    return known, alone, lit


def _block(model: ForwardModel) -> int:
    """Return how many images are worked on at a time."""
    return max(1, BLOCK_READINGS // model.array.side**2)
