"""What designs of array and lamp are worth: the paper's criterion, the bound, and the best of them.

Eren et al. (2016) judge a design by whether its signature tells 0.2 m and 10 deg apart 4 to 8 m
behind the lamp, and by how few detectors that takes. docs/results/design_study.md says what each
score means.
"""

import dataclasses
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.cli.options import SEED
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.signature.spectral_angle import spectral_angle
from uuv_optical_array.estimation.signature_table import Progress
from uuv_optical_array.forward.lamps import together
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import (
    MIN_PEAK_COUNTS,
    RANGES_M,
    known_volume_std,
    uniform_poses,
)
from uuv_optical_array.studies.design_sweep import Design, Mount, Power, Sweep, designed
from uuv_optical_array.studies.shared.errors import position_and_angle
from uuv_optical_array.studies.shared.pareto import thinned_front
from uuv_optical_array.studies.shared.results import Line, Results
from uuv_optical_array.studies.shared.separation import (
    THRESHOLD_DEG,
    WANTED,
    Conditions,
    Motion,
    angles_deg,
    from_paper_axes,
    scene_signature,
)

CLEAR_SIGMAS = 3.0
# What Eren et al. (2016) choose; their lamp is not given.
PAPER: dict[str, Any] = {
    "shape": "curved",
    "detectors_per_side": 5,
    "width_m": 0.4,
    "radius_m": 0.32,
}
NOISE_DRAWS = 64
ROUNDING_DEG = 1e-9  # angles below are rounding: the converter took all noise away
BLOCK_READINGS = 1 << 14  # worked on at a time, which bounds the memory


@dataclass(frozen=True)
class ScoredDesign(Line, Design):
    """A design and what it is worth.

    Spectral angles of a ``shift`` by 0.2 m and a ``yaw`` by 10 deg are the smaller of both signs;
    ``near`` at 4 m, else the least of `RANGES_M`; nan where the aligned image is flat. ``sigmas``
    are these over the RMS angle by which noise moves the signature there. `position_m` and
    `angle_deg` are RMS bounds over the volume, as `known_volume_std`; `lit` is the share of it
    where the image peaks above `MIN_PEAK_COUNTS`, and ``lit_`` bounds are those of the image alone
    there: nan where there is none, inf where a pose is unobservable.
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
    moved_deg = np.array([separations(scene, motion) for motion in WANTED])
    noise_deg = np.array([signature_noise_deg(model, range_m, rng) for range_m in RANGES_M])
    with np.errstate(divide="ignore", invalid="ignore"):
        sigmas = moved_deg / np.where(noise_deg > ROUNDING_DEG, noise_deg, 0.0)
    known, alone, lit = bounds(model, poses)
    values: list[Any] = [
        *vars(Design.of(scene)).values(),
        scene.lamp.reference_counts,
        *(moved_deg[:, 0].tolist() + moved_deg.min(axis=1).tolist()),
        *(sigmas[:, 0].tolist() + sigmas.min(axis=1).tolist()),
        *position_and_angle(known),
        float(lit.mean()),
        *position_and_angle(alone[lit]),
    ]
    return ScoredDesign(*values)


def separations(scene: Scene, motion: Motion) -> list[float]:
    """Return the spectral angle of a wanted move, the smaller of both signs, deg, at `RANGES_M`."""
    shape, side = scene.array.shape, scene.array.detectors_per_side
    steps = [WANTED[motion], -WANTED[motion]]
    every = (Conditions(shape, side, range_m, motion) for range_m in RANGES_M)
    return [float(angles_deg(scene, conditions, steps).min()) for conditions in every]


def signature_noise_deg(model: ForwardModel, range_m: float, rng: np.random.Generator) -> float:
    """Return by what angle noise moves the signature of the aligned array, deg, RMS of a few draws.

    The array is `range_m` behind the lamp, and the angle is that from the noiseless signature.
    """
    pose = from_paper_axes([range_m, 0, 0, 0, 0])
    clean = together(model.expected(pose))
    on_axis_counts = float(clean.max())
    calm = scene_signature(clean, on_axis_counts, model.scene)
    squares = 0.0
    for poses in _blocks(model, np.broadcast_to(pose, (NOISE_DRAWS, 5))):
        readings = together(model.expose(poses, rng))
        angles = spectral_angle(calm, scene_signature(readings, on_axis_counts, model.scene))
        squares += float((angles**2).sum())
    return math.degrees(math.sqrt(squares / NOISE_DRAWS))


def bounds(model: ForwardModel, poses: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return least standard deviations at poses, m and rad, ``(n, 5)``, and where there is light.

    Of an image whose pose is known to lie in the volume, and of the image alone.
    """
    parts = []
    for block in _blocks(model, poses):
        bound = cramer_rao_bound(model, block)
        lit = model.expected(block).max(axis=(-2, -1)) > MIN_PEAK_COUNTS
        parts.append((known_volume_std(bound.information), bound.std, lit))
    known, alone, where = map(np.concatenate, zip(*parts, strict=True))
    return known, alone, where


def _blocks(model: ForwardModel, poses: Array) -> list[Array]:
    """Part poses into as many as are worked on at a time."""
    step = max(1, BLOCK_READINGS // model.array.side**2)
    return [poses[start : start + step] for start in range(0, len(poses), step)]


@dataclass(frozen=True)
class DesignStudy:
    """A sweep, and how it is scored; `power` and `mount` as in `designed`."""

    scene: Scene
    sweep: Sweep
    power: Annotated[
        Power,
        Quantity(
            "lamps of equal flux; the same with the gain turned down where they would read "
            "brighter than the scene's own; or lamps of equal counts"
        ),
    ] = "flux"
    mount: Annotated[
        Mount,
        Quantity(
            "what stays in its place: the foremost point, or the array's frame, which is the "
            "centre of a sphere as in the paper"
        ),
    ] = "front"
    poses: Annotated[int, Quantity("poses at which the bound is taken", "", 1, 1e7)] = 1000
    seed: Annotated[int, SEED] = 1

    @property
    def origin(self) -> dict[str, Any]:
        """What its scores depend on beside the design."""
        own = {name: vars(self)[name] for name in ("power", "mount", "poses", "seed")}
        return {"scene": self.scene.name, "fingerprint": self.scene.fingerprint, **own}

    def score_rest(self, results: Results[ScoredDesign], progress: Progress = iter) -> None:
        """Score the designs that have no score yet; after Ctrl-C those scored so far are kept."""
        scored_before = {line.design for line in results.lines}
        left = [design for design in self.sweep.designs() if design not in scored_before]
        poses = uniform_poses(self.poses, np.random.default_rng([self.seed, 0]))
        scored: list[ScoredDesign] = []
        try:
            for i in progress(range(len(left))):
                scene = designed(self.scene, left[i], self.power, self.mount)
                scored.append(score(scene, poses, np.random.default_rng([self.seed, 1])))
        finally:
            if scored:
                results.append(scored)

    def swept(self, results: Results[ScoredDesign]) -> list[ScoredDesign]:
        """Return the designs of the sweep that have a score, in its order."""
        scored = {line.design: line for line in results.lines}
        return [scored[design] for design in self.sweep.designs() if design in scored]


def front(rows: Sequence[ScoredDesign]) -> list[ScoredDesign]:
    """Return the designs that represent all in detectors and bounds, fewest detectors first."""
    bounds = np.reshape([(row.position_m, row.angle_deg) for row in rows], (-1, 2))
    kept = [rows[i] for i in thinned_front([row.detectors for row in rows], bounds)]
    return sorted(kept, key=lambda row: (row.detectors, row.position_m))


@dataclass(frozen=True)
class Choice:
    """What a sweep offers: the Pareto-optimal designs among its scored ones."""

    study: DesignStudy
    rows: Sequence[ScoredDesign]

    @cached_property
    def fronts(self) -> dict[str, list[ScoredDesign]]:
        """Fronts of what is no wider than the scene's array, of what resolves, and of all."""
        fits = [row for row in self.rows if row.width_m <= self.study.scene.array.width_m]
        resolved = [row for row in fits if row.resolved_at_4m]
        return {"fits": front(fits), "resolved": front(resolved), "any": front(self.rows)}

    @cached_property
    def papers(self) -> list[ScoredDesign]:
        """The paper's array with the scene's lamps, where it is swept."""
        own = dataclasses.replace(Design.of(self.study.scene), **PAPER)
        return [row for row in self.rows if row.design == own]

    @cached_property
    def numbered(self) -> list[ScoredDesign]:
        """Every design that is listed, once: the fronts in turn, then the paper's array."""
        on_fronts = [row for rows in self.fronts.values() for row in rows]
        return list(dict.fromkeys([*on_fronts, *self.papers]))

    def table(self, numbers: Collection[int] | None = None) -> str:
        """Return `numbered` as a table, or those of some numbers, from 1."""
        heads = ("position", "angle", "lit", "at 4 m", "4 to 8 m", "", "15 deg", "")
        width = max(51, 2 + max((len(row.label) for row in self.numbered), default=0))
        line = f"{{:>3}} {{:<{width}}}{{:>8}}{{:>7}}{{:>5}}{{:>12}}{{:>12}}{{:>7}}  {{:<9}}{{}}"
        units = ("m", "deg", "%", "deg", "deg", "sigma", "at", "front")
        lines = [line.format("no", "design", *heads), line.format("", "", *units)]
        for number, row in enumerate(self.numbered, start=1):
            on_fronts = [name for name, rows in self.fronts.items() if row in rows] or ["none"]
            values = (
                *(row.label, f"{row.position_m:.3f}", f"{row.angle_deg:.2f}"),
                f"{100 * row.lit:.0f}",
                f"{row.shift_near_deg:.1f}, {row.yaw_near_deg:.1f}",
                f"{row.shift_deg:.1f}, {row.yaw_deg:.1f}",
                *(f"{row.sigmas:.1f}", row.resolved),
                ", ".join(on_fronts) + "; the paper's array" * row.is_papers_array,
            )
            if numbers is None or number in numbers:
                lines.append(line.format(number, *values))
        return "\n".join(lines)

    @property
    def resolved_counts(self) -> tuple[int, int, int]:
        """How many meet the criterion at 4 m, from 4 to 8 m, and there beyond noise."""
        far = [row for row in self.rows if row.resolved_4_to_8m]
        clear = sum(row.sigmas >= CLEAR_SIGMAS for row in far)
        return sum(row.resolved_at_4m for row in self.rows), len(far), clear

    def as_object(self) -> dict[str, Any]:
        """Return plain values; None is not known, or has no bound."""
        study, at = self.study, {id(row): i for i, row in enumerate(self.rows)}
        about = {name: vars(study)[name] for name in ("power", "mount", "poses", "seed")}
        return {
            "scene": study.scene.name,
            "sweep": vars(study.sweep),
            **about,
            "designs": [row.columns() for row in self.rows],
            "fronts": {name: [at[id(row)] for row in rows] for name, rows in self.fronts.items()},
            "numbered": [at[id(row)] for row in self.numbered],
            "papers_array": [i for i, row in enumerate(self.rows) if row.is_papers_array],
            "dropped": study.sweep.dropped(),
        }
