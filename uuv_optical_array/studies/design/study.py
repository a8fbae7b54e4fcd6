"""A sweep of designs, scored one by one."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from uuv_optical_array.estimation.signature_table import Progress
from uuv_optical_array.forward.scene import Scene, scene_from_settings
from uuv_optical_array.forward.working_volume import uniform_poses
from uuv_optical_array.studies.design.designs import Design, Mount, Power, Sweep, designed
from uuv_optical_array.studies.design.score import Score, score
from uuv_optical_array.studies.results import Flat, Results


@dataclass(frozen=True)
class ScoredDesign(Flat):
    """A design and its score: a line of the CSV."""

    design: Design
    score: Score

    def columns(self) -> dict[str, Any]:
        """Return the values by column."""
        return {
            **vars(self.design),
            "detectors": self.design.detectors,
            **vars(self.score),
            "resolved_at_4_m": self.score.resolved_at_4m,
            "resolved_4_to_8_m": self.score.resolved_4_to_8m,
        }


@dataclass(frozen=True)
class ScoreOrigin:
    """What scores depend on beside their design, as in `DesignStudy`."""

    scene: str
    fingerprint: str
    power: str
    mount: str
    poses: int
    seed: int


@dataclass(frozen=True)
class DesignStudy:
    """A sweep, and how it is scored.

    Parameters
    ----------
    scene
        Whose array and lamp are replaced.
    sweep
        By what.
    power, mount
        As in `designs.designed`.
    poses
        How many the bound is taken at, >= 1; the same for all designs.
    seed
        Of poses and noise.
    """

    scene: Scene
    sweep: Sweep
    power: Power = "flux"
    mount: Mount = "front"
    poses: int = 1000
    seed: int = 1

    @property
    def origin(self) -> ScoreOrigin:
        """What its scores depend on."""
        return ScoreOrigin(
            self.scene.name,
            self.scene.fingerprint,
            self.power,
            self.mount,
            self.poses,
            self.seed,
        )

    def scene_of(self, design: Design, name: str) -> Scene:
        """Return the scene that has a design, by a name of its own."""
        found = designed(self.scene, design, self.power, self.mount)
        return scene_from_settings(found.settings(), name)

    def score_rest(
        self, results: Results[ScoreOrigin, ScoredDesign], progress: Progress = iter
    ) -> None:
        """Score the designs that have no score yet; an interrupt keeps those that were scored.

        Parameters
        ----------
        results
            Of this study; the scores are added to them. A design has one score, whatever else is
            swept.
        progress
            Wraps the loop over designs.
        """
        there = {found.design for found in results.lines}
        left = [design for design in self.sweep.designs() if design not in there]
        poses = uniform_poses(self.poses, np.random.default_rng([self.seed, 0]))
        scored: list[ScoredDesign] = []
        try:
            for i in progress(range(len(left))):
                scene = designed(self.scene, left[i], self.power, self.mount)
                noise = np.random.default_rng([self.seed, 1])
                scored.append(ScoredDesign(left[i], score(scene, poses, noise)))
        finally:
            if scored:
                results.append(scored)

    def swept(self, results: Results[ScoreOrigin, ScoredDesign]) -> list[ScoredDesign]:
        """Return the designs of the sweep that have a score, in its order."""
        scored = {found.design: found for found in results.lines}
        return [scored[design] for design in self.sweep.designs() if design in scored]
