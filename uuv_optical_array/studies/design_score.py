"""What designs of array and lamp are worth: the paper's criterion, the bound, and the best of them.

Eren et al. (2016) judge a design by whether its signature tells 0.2 m and 10 deg apart 4 to 8 m
behind the lamp, and by how few detectors that takes. docs/results/design_study.md says what each
score means.
"""

import dataclasses
import math
from dataclasses import dataclass
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
from uuv_optical_array.studies.shared.results import Line, Results
from uuv_optical_array.studies.shared.separation import (
    THRESHOLD_DEG,
    WANTED,
    Conditions,
    angles_deg,
    from_paper_axes,
    scene_signature,
)

CLEAR_SIGMAS = 3.0
# What Eren et al. (2016) choose; their lamp is not given.
PAPER: dict[str, Any] = {"shape": "curved", "detectors_per_side": 5}
PAPER |= {"width_m": 0.4, "radius_m": 0.32}
HOW = "power", "mount", "poses"  # a design is scored
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
    shape, side = scene.array.shape, scene.array.detectors_per_side
    # Of both signs of a move the smaller angle.
    moved_deg = np.array([
        [angles_deg(scene, Conditions(shape, side, m, motion), [by, -by]).min() for m in RANGES_M]
        for motion, by in WANTED.items()
    ])  # fmt: skip
    noise_deg = np.array([signature_noise_deg(model, range_m, rng) for range_m in RANGES_M])
    with np.errstate(divide="ignore", invalid="ignore"):
        sigmas = moved_deg / np.where(noise_deg > ROUNDING_DEG, noise_deg, 0.0)
    known, alone, lit = bounds(model, poses)
    values: list[Any] = [*vars(Design.of(scene)).values(), scene.lamp.reference_counts]
    for measure in (moved_deg, sigmas):
        values += [*measure[:, 0].tolist(), *measure.min(axis=1).tolist()]
    values += [*position_and_angle(known), float(lit.mean()), *position_and_angle(alone[lit])]
    return ScoredDesign(*values)


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
    seed: Annotated[int, SEED] = 1

    @property
    def origin(self) -> dict[str, Any]:
        """What its scores depend on beside the design."""
        own = {name: vars(self)[name] for name in (*HOW, "seed")}
        return {"scene": self.scene.name, "fingerprint": self.scene.fingerprint, **own}

    def score_rest(self, results: Results[ScoredDesign], progress: Progress = iter) -> None:
        """Score the designs that have no score yet; after Ctrl-C those scored so far are kept."""
        before = {row.design for row in results.lines}
        left = [design for design in self.sweep.designs() if design not in before]
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
