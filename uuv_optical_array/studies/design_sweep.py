"""Designs of array and lamp: a grid of them, the scene of each, and what it is worth.

Eren et al. (2016) judge a design by whether its signature tells 0.2 m and 10 deg apart 4 to 8 m
behind the lamp, and by how few detectors that takes. docs/results/design_study.md says what each
score means.
"""

import dataclasses
import itertools
import math
import typing
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.cli import progress
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity, Setting, check, declared
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.signature.spectral_angle import spectral_angle
from uuv_optical_array.forward import working_volume as volume
from uuv_optical_array.forward.array import ArraySettings, Shape
from uuv_optical_array.forward.lamps import ring_of_lamps, spread_and_tilt, together
from uuv_optical_array.forward.light import LampSettings, beam_solid_angle
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.studies.shared.errors import position_and_angle
from uuv_optical_array.studies.shared.results import Line, Results
from uuv_optical_array.studies.shared.separation import (
    THRESHOLD_DEG,
    WANTED,
    Conditions,
    angles_deg,
    from_paper_axes,
    paper_signature,
)

# How bright each design's lamp is; `designed` explains.
Power: TypeAlias = Literal["flux", "flux_in_range", "counts"]
Mount: TypeAlias = Literal["front", "centre"]

# What a sweep has lists of.
RING = declared(ring_of_lamps)
SWEPT: dict[str, Setting] = {
    name: (declared(ArraySettings) | declared(LampSettings))[name]
    for name in ("shape", "detectors_per_side", "width_m", "radius_m", "beam_sigma_deg")
} | RING
# Radii of 0.8 widths are as curved as the paper's.
DEFAULTS: dict[str, tuple[Any, ...]] = {
    "detectors_per_side": (3, 5, 7, 9, 11, 21),
    "width_m": (0.2, 0.3, 0.4, 0.5, 0.6),
    "radius_m": (0.16, 0.24, 0.32, 0.4, 0.48, 0.64),
    "beam_sigma_deg": (4.0, 6.0, 8.0, 11.0, 15.0, 20.0),
}
# Powers of the gain by which settings change that are a reading of the light, or its inverse.
WITH_GAIN = (
    ("ambient", "level_counts", 1),
    ("ambient", "surface_counts", 1),
    ("shot_noise", "electrons_per_count", -1),
    ("photodiode", "amps_per_count", -1),
    ("photodiode", "watts_per_m2_per_count", -1),
)
# What Eren et al. (2016) choose; their lamp is not given.
PAPER: dict[str, Any] = {"shape": "curved", "detectors_per_side": 5}
PAPER |= {"width_m": 0.4, "radius_m": 0.32}
HOW, SEED = ("power", "mount", "poses"), 1  # by what a design is scored
NOISE_DRAWS = 64
ROUNDING_DEG = 1e-9  # angles below are rounding: the converter took all noise away
BLOCK_READINGS = 1 << 14


@dataclass(frozen=True)
class Design:
    """An array and lamps; settings as in `ArraySettings`, `LampSettings`, `ring_of_lamps`."""

    shape: Shape
    detectors_per_side: int
    width_m: float
    radius_m: float | None
    beam_sigma_deg: float
    lamps: int
    spread_m: float
    tilt_deg: float

    @classmethod
    def of(cls, scene: Scene) -> "Design":
        """Return the design that a scene has; of several lamps with the means of their ring."""
        ring = scene.lamp_count, *spread_and_tilt(scene.lamps)
        values: dict[str, Any] = {**vars(scene.array), **vars(scene.lamp)}
        values |= dict(zip(RING, ring, strict=True))
        return cls(**{name: values[name] for name in SWEPT})

    @property
    def detectors(self) -> int:
        """How many there are."""
        return self.detectors_per_side**2

    @property
    def label(self) -> str:
        """The design in words."""
        radius = "" if self.radius_m is None else f", radius {self.radius_m:g} m"
        side, beam = self.detectors_per_side, f"beam {self.beam_sigma_deg:g} deg"
        lamps = f", {self.lamps} lamps {self.ring}" if self.lamps > 1 else ""
        return f"{self.shape} {side} x {side}, {self.width_m:g} m{radius}, {beam}{lamps}"

    @property
    def ring(self) -> str:
        """Where several lamps are, in words."""
        return f"at {self.spread_m:g} m, {self.tilt_deg:g} deg"


@dataclass(frozen=True)
class Sweep:
    """A grid of designs, without those that cannot be built; a radius is for curved arrays alone.

    ValueError for an empty list, a value given twice or out of bounds, and where nothing is left.
    """

    shape: Sequence[Shape]
    detectors_per_side: Sequence[int]
    width_m: Sequence[float]
    radius_m: Sequence[float]
    beam_sigma_deg: Sequence[float]
    lamps: Sequence[int] = (1,)
    spread_m: Sequence[float] = (0.0,)
    tilt_deg: Sequence[float] = (0.0,)

    def __post_init__(self) -> None:
        for name, setting in SWEPT.items():
            hint: Any = Annotated[setting.kind, setting.quantity]
            values = [check(hint, value, name) for value in getattr(self, name)]
            if not values and (name != "radius_m" or "curved" in self.shape):
                raise ValueError(f"{name}: no value; give at least one")
            for value in values:
                if values.count(value) > 1:
                    raise ValueError(f"{name}: {value} is given twice; give it once")
            object.__setattr__(self, name, tuple(values))
        if not self.designs():
            reasons = "; ".join(self.dropped())
            raise ValueError(f"radius_m: no design is left ({reasons}); give a larger one")

    def designs(self) -> list[Design]:
        """List what can be built, the number of detectors changing fastest."""
        return [design for design in self._grid() if not _fault(design)]

    def dropped(self) -> dict[str, int]:
        """Count what cannot be built, by the reason."""
        return dict(Counter(filter(None, map(_fault, self._grid()))))

    def _grid(self) -> Iterator[Design]:
        every = itertools.product(self.lamps, self.spread_m, self.tilt_deg)
        # One lamp is in the middle.
        rings = list(dict.fromkeys(ring if ring[0] > 1 else (1, 0.0, 0.0) for ring in every))
        for shape in self.shape:
            radii, sides = self.radius_m if shape == "curved" else (None,), self.detectors_per_side
            grid = itertools.product(radii, self.width_m, self.beam_sigma_deg, rings, sides)
            for radius_m, width_m, sigma_deg, ring, side in grid:
                yield Design(shape, side, width_m, radius_m, sigma_deg, *ring)


def sweep_of(scene: Scene, words: Sequence[str] = ()) -> Sweep:
    """Return a sweep about a scene's own design, or of lists, each ``NAME=VALUE,VALUE``."""
    lists: dict[str, list[Any]] = {}
    for word in words:
        name, _, values = word.partition("=")
        if name not in SWEPT:
            raise ValueError(f"{word}: give NAME=VALUE,... with NAME one of {', '.join(SWEPT)}")
        if name in lists:
            raise ValueError(f"{name}: given twice; give its values once")
        kind = SWEPT[name].kind
        try:
            lists[name] = [kind(v) if kind in (int, float) else v for v in values.split(",")]
        except ValueError:
            raise ValueError(f"{word}: give numbers with commas between them") from None
    own = vars(Design.of(scene))
    about = {name: sorted({*values, own[name] or values[0]}) for name, values in DEFAULTS.items()}
    about |= {"shape": [*typing.get_args(Shape)], **{name: [own[name]] for name in RING}}
    return Sweep(**{**about, **lists})


def _fault(design: Design) -> str:
    """Say why a design cannot be built, alike for all that share the reason; empty: it can be."""
    try:
        ArraySettings(design.shape, 2, design.width_m, 0.0, design.radius_m)
    except ValueError:
        return f"{design.width_m:g} m wide on a sphere of {design.radius_m:g} m: corners beyond it"
    if design.lamps > 1 and not (design.spread_m or design.tilt_deg):
        return "several lamps in one place that point the same way"
    return ""


def designed(scene: Scene, design: Design, power: Power = "flux", mount: Mount = "front") -> Scene:
    """Return a scene with the array and the lamp of a design, and the lamp's power set.

    By a power of ``flux`` the lamp emits as much light as the scene's, into a beam of another
    width. ``flux_in_range`` is the same light, but where the aligned array would read more of it at
    the reference range than the scene's does, the gain is turned down until it reads the same;
    noise behind the gain stays as it is in counts. By ``counts`` the lamp is as strong as it takes
    for the same reading. By a mount of ``front`` the foremost point of the array stays where the
    scene's is, by ``centre`` the array's frame, as Eren et al. (2016) have it. A ValueError says
    that the array cannot be built, or gets no light at the reference range.
    """
    bow_m = scene.array.bow_m
    if mount == "front":
        bow_m += (scene.array.radius_m or 0.0) - (design.radius_m or 0.0)
    side, radius_m = design.detectors_per_side, design.radius_m
    array = ArraySettings(design.shape, side, design.width_m, bow_m, radius_m)
    lamp = dataclasses.replace(scene.lamp, beam_sigma_deg=design.beam_sigma_deg)
    own, ring = Design.of(scene), {name: getattr(design, name) for name in RING}
    lamps = scene.lamps if ring.items() <= vars(own).items() else ring_of_lamps(**ring)
    if lamps and not scene.lamps:
        raise ValueError(
            f"lamps: {design.lamps}: scene {scene.name} has one and no prior of several; take one "
            "that extends leading_lights"
        )
    changed = dataclasses.replace(scene, array=array, lamp=lamp).with_lamps(lamps)
    if power == "counts" or design == own:
        return changed
    own_sr, beam_sr = (
        beam_solid_angle(math.radians(it.beam_sigma_deg)) for it in (scene.lamp, design)
    )
    brighter = ForwardModel(scene).power * own_sr / beam_sr / ForwardModel(changed).power
    if power == "flux_in_range" and brighter > 1:
        return with_gain(changed, 1 / brighter)
    lamp = dataclasses.replace(lamp, reference_counts=brighter * lamp.reference_counts)
    return dataclasses.replace(changed, lamp=lamp)


def with_gain(scene: Scene, gain: float) -> Scene:
    """Return a scene whose electronics give `gain` times the counts for the same light.

    The lamp's `reference_counts` are not touched: they say how strong the lamp is after the change.
    """
    effects = {name: dict(settings) for name, settings in scene.effects.items()}
    for name, key, power in WITH_GAIN:
        if effects.get(name, {}).get(key) is not None:
            effects[name][key] *= gain**power
    std_counts = gain * scene.prior.ambient_std_counts
    prior = dataclasses.replace(scene.prior, ambient_std_counts=std_counts)
    return dataclasses.replace(scene, effects=effects, prior=prior)


@dataclass(frozen=True)
class ScoredDesign(Line, Design):
    """A design and what it is worth.

    Spectral angles of a ``shift`` by 0.2 m and a ``yaw`` by 10 deg are the smaller of both signs;
    nan where the aligned image is flat. ``sigmas`` are these over the RMS angle by which noise
    moves the signature there.
    """

    reference_counts: float
    shift_near_deg: float  # at 4 m
    yaw_near_deg: float
    shift_deg: float  # the least of `RANGES_M`
    yaw_deg: float
    shift_near_sigmas: float
    yaw_near_sigmas: float
    shift_sigmas: float
    yaw_sigmas: float
    position_m: float  # RMS bounds over the volume, as `known_volume_std`
    angle_deg: float
    lit: float  # share of the volume where the image peaks above `MIN_PEAK_COUNTS`
    lit_position_m: float  # bounds of the image alone there; nan for no place, inf: unobservable
    lit_angle_deg: float

    @property
    def resolved_at_4m(self) -> bool:
        """Whether both moves reach the paper's threshold at 4 m, which is where it decides."""
        return min(self.shift_near_deg, self.yaw_near_deg) >= THRESHOLD_DEG

    @property
    def resolved_4_to_8m(self) -> bool:
        """Whether they do from 4 to 8 m, which is what it claims."""
        return min(self.shift_deg, self.yaw_deg) >= THRESHOLD_DEG

    @property
    def resolved(self) -> str:
        """Say where both moves reach the threshold."""
        return "4 to 8 m" if self.resolved_4_to_8m else "4 m" if self.resolved_at_4m else "none"

    @property
    def sigmas(self) -> float:
        """The lesser of `shift_sigmas` and `yaw_sigmas`."""
        return min(self.shift_sigmas, self.yaw_sigmas)

    @property
    def design(self) -> Design:
        """The design alone."""
        return Design(*(vars(self)[field.name] for field in dataclasses.fields(Design)))

    @property
    def is_papers_array(self) -> bool:
        """Whether it has the array that the paper chooses, whatever its lamp."""
        return vars(self) | PAPER == vars(self)

    def columns(self) -> dict[str, Any]:
        """Return the values by column."""
        near, far = self.resolved_at_4m, self.resolved_4_to_8m
        resolved = {"resolved_at_4_m": near, "resolved_4_to_8_m": far}
        return {**vars(self), "detectors": self.detectors, **resolved}


def score(scene: Scene, poses: Array, rng: np.random.Generator) -> ScoredDesign:
    """Score the array and lamp of a scene; the bound at `poses` ``(n, 5)``, noise from `rng`."""
    model = ForwardModel(scene)
    shape, side = scene.array.shape, scene.array.detectors_per_side
    # Of both signs of a move the smaller angle.
    ranges_m = volume.RANGES_M
    moved_deg = np.array([
        [angles_deg(scene, Conditions(shape, side, m, motion), [by, -by]).min() for m in ranges_m]
        for motion, by in WANTED.items()
    ])  # fmt: skip
    noise_deg = np.array([signature_noise_deg(model, range_m, rng) for range_m in ranges_m])
    with np.errstate(divide="ignore", invalid="ignore"):
        sigmas = moved_deg / np.where(noise_deg > ROUNDING_DEG, noise_deg, 0.0)
    known, alone, lit = bounds(model, poses)
    values: list[Any] = [*vars(Design.of(scene)).values(), scene.lamp.reference_counts]
    for measure in (moved_deg, sigmas):
        values += [*measure[:, 0].tolist(), *measure.min(axis=1).tolist()]
    values += [*position_and_angle(known), float(lit.mean()), *position_and_angle(alone[lit])]
    return ScoredDesign(*values)


def signature_noise_deg(model: ForwardModel, range_m: float, rng: np.random.Generator) -> float:
    """Return by what angle noise moves the signature of the aligned array, deg, RMS of draws."""
    pose = from_paper_axes([range_m, 0, 0, 0, 0])
    clean, peak = together(model.expected(pose)), model.scene.signature.peak
    on_axis_counts = float(clean.max())
    calm = paper_signature(clean, on_axis_counts, peak)
    squares = 0.0
    for poses in _blocks(model, np.broadcast_to(pose, (NOISE_DRAWS, 5))):
        readings = together(model.expose(poses, rng))
        angles = spectral_angle(calm, paper_signature(readings, on_axis_counts, peak))
        squares += float((angles**2).sum())
    return math.degrees(math.sqrt(squares / NOISE_DRAWS))


def bounds(model: ForwardModel, poses: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return least standard deviations at poses, m and rad, ``(n, 5)``, and where there is light.

    Of an image whose pose is known to lie in the volume, and of the image alone.
    """
    parts = []
    for block in _blocks(model, poses):
        bound = cramer_rao_bound(model, block)
        lit = model.expected(block).max(axis=(-2, -1)) > volume.MIN_PEAK_COUNTS
        parts.append((volume.known_volume_std(bound.information), bound.std, lit))
    known, alone, where = map(np.concatenate, zip(*parts, strict=True))
    return known, alone, where


def _blocks(model: ForwardModel, poses: Array) -> list[Array]:
    """Part poses into as many as are worked on at a time, which bounds the memory."""
    step = max(1, BLOCK_READINGS // model.array.side**2)
    return np.array_split(poses, range(step, len(poses), step))


POWER = Quantity(
    "lamps of equal flux; the same with the gain turned down where they would read brighter than "
    "the scene's own; or lamps of equal counts"
)
MOUNT = Quantity(
    "what stays in its place: the foremost point, or the array's frame, which is the centre of a "
    "sphere as in the paper"
)


@dataclass(frozen=True)
class DesignStudy:
    """A sweep, and how it is scored; `power` and `mount` as in `designed`."""

    scene: Scene
    sweep: Sweep
    power: Annotated[Power, POWER] = "flux"
    mount: Annotated[Mount, MOUNT] = "front"
    poses: Annotated[int, Quantity("poses at which the bound is taken", "", 1, 1e7)] = 1000

    @property
    def origin(self) -> dict[str, Any]:
        """What its scores depend on beside the design."""
        about = {"scene": self.scene.name, "fingerprint": self.scene.fingerprint}
        return about | {name: vars(self)[name] for name in HOW} | {"seed": SEED}

    def score_rest(self, results: Results[ScoredDesign]) -> None:
        """Score the designs that have no score yet; after Ctrl-C those scored so far are kept."""
        before = {row.design for row in results.lines}
        left = [design for design in self.sweep.designs() if design not in before]
        poses = volume.uniform_poses(self.poses, np.random.default_rng([SEED, 0]))
        scored: list[ScoredDesign] = []
        try:
            for design in progress.over(left, "design"):
                scene = designed(self.scene, design, self.power, self.mount)
                scored.append(score(scene, poses, np.random.default_rng([SEED, 1])))
        finally:
            if scored:
                results.append(scored)

    def swept(self, results: Results[ScoredDesign]) -> list[ScoredDesign]:
        """Return the designs of the sweep that have a score, in its order."""
        scored = {line.design: line for line in results.lines}
        return [scored[design] for design in self.sweep.designs() if design in scored]
