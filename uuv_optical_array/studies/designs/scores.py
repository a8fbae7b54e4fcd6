"""What a design is worth: the criteria of Eren et al. (2016), and the Cramer-Rao bound."""

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.signature.spectral_angle import spectral_angle
from uuv_optical_array.forward import working_volume as volume
from uuv_optical_array.forward.lamp.lamps import together
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.studies.designs.sweep import Design, designed
from uuv_optical_array.studies.shared.errors import blocks, bounds, position_and_angle
from uuv_optical_array.studies.shared.results import read
from uuv_optical_array.studies.shared.separation import (
    THRESHOLD_DEG,
    WANTED,
    Conditions,
    angles_deg,
    from_paper_axes,
    paper_signature,
)

# What Eren et al. (2016) choose; their lamp is not given.
PAPER: dict[str, Any] = {"shape": "curved", "detectors_per_side": 5}
PAPER |= {"width_m": 0.4, "radius_m": 0.32}
SEED = 1
NOISE_DRAWS = 64
ROUNDING_DEG = 1e-9  # angles below are rounding: the converter took all noise away


@dataclass(frozen=True)
class ScoredDesign(Design):
    """A design and what it is worth.

    Spectral angles of a ``shift`` by 0.2 m and a ``yaw`` by 10 deg are the smaller of both signs,
    nan where the aligned image is flat; ``sigmas`` are these over the RMS angle by noise there.
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
    ranges_m = volume.RANGES_M
    moved_deg = np.array([
        [angles_deg(scene, Conditions(shape, side, m, motion), [by, -by]).min() for m in ranges_m]
        for motion, by in WANTED.items()
    ])  # fmt: skip
    noise_deg = np.array([signature_noise_deg(model, range_m, rng) for range_m in ranges_m])
    with np.errstate(divide="ignore", invalid="ignore"):
        sigmas = moved_deg / np.where(noise_deg > ROUNDING_DEG, noise_deg, 0.0)
    information, alone = bounds(model, poses)
    known = volume.known_volume_std(information)
    peaks = [model.expected(block).max(axis=(-2, -1)) for block in blocks(model, poses)]
    lit = np.concatenate(peaks) > volume.MIN_PEAK_COUNTS
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
    readings = together(model.expose(np.broadcast_to(pose, (NOISE_DRAWS, 5)), rng))
    angles = spectral_angle(calm, paper_signature(readings, on_axis_counts, peak))
    return math.degrees(np.sqrt(np.mean(angles**2)))


def origin(scene: Scene, poses: int) -> dict[str, Any]:
    """Return what scores depend on beside the design; `poses` is the number of them."""
    about = {"scene": scene.name, "fingerprint": scene.fingerprint}
    return {**about, "poses": poses, "seed": SEED}


def scored(scene: Scene, designs: Iterable[Design], poses: int) -> Iterator[ScoredDesign]:
    """Yield designs of a scene's array and lamp with their scores, bounds at so many poses."""
    places = volume.uniform_poses(poses, np.random.default_rng([SEED, 0]))
    for design in designs:
        yield score(designed(scene, design), places, np.random.default_rng([SEED, 1]))


def scored_before(path: Path, origin: Mapping[str, Any]) -> list[ScoredDesign]:
    """Read the designs that a file has scores of.

    ValueError where they are of another `origin`, in which a scene's name does not count.
    """
    there, rows = read(path, ScoredDesign)
    differ = "; ".join(
        f"{name} is {there.get(name)} there and {value} here"
        for name, value in {**dict.fromkeys(there), **origin}.items()
        if there and name != "scene" and there.get(name) != str(value)
    )
    if differ:
        error = f"{path}: holds results of another run: {differ}"
        raise ValueError(f"{error}; remove the file or name another")
    return rows
