"""A sweep of designs, scored chunk by chunk: `chunks.ChunkedRows` on disk, and the rows as a CSV.

A row of the array is a design in the sweep's order, and a column a field of `Score`. The attributes
hold what the scores depend on.
"""

import csv
import dataclasses
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from uuv_optical_array.core import files
from uuv_optical_array.core.chunks import ChunkedRows
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.scene import Scene, scene_from_settings
from uuv_optical_array.studies.design.designs import Design, Mount, Power, Sweep, designed
from uuv_optical_array.studies.design.score import BLOCK_READINGS, Score, score
from uuv_optical_array.studies.shared.working_volume import uniform_poses

FORMAT = 1
CHUNK_DESIGNS = 8  # about a second's work
COLUMNS = tuple(field.name for field in dataclasses.fields(Score))
# The temporaries of a Jacobian and its information, for each reading that is worked on.
READING_BYTES = 700
KIND, COMMAND = "design study", "uuv_array design"


class Row(NamedTuple):
    """A design and its score."""

    design: Design
    score: Score

    def values(self) -> dict[str, Any]:
        """Return the columns of the CSV."""
        design, score = self
        return {
            **vars(design),
            "detectors": design.detectors,
            **vars(score),
            "told_at_4_m": score.told_near,
            "told_4_to_8_m": score.told,
        }

    def as_object(self) -> dict[str, Any]:
        """Return the same for JSON; None is not known, or has no bound."""
        return {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in self.values().items()
        }


@dataclass(frozen=True)
class Study:
    """What the scores of a sweep depend on.

    Parameters
    ----------
    scene
        Whose array and lamp are replaced.
    sweep
        By what.
    power, mount
        As in `design.designed`.
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

    def as_object(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "scene": self.scene.settings(),
            "sweep": self.sweep.as_object(),
            "power": self.power,
            "mount": self.mount,
            "poses": self.poses,
            "seed": self.seed,
        }

    def scored(self, designs: Sequence[Design]) -> Array:
        """Score designs, whatever others there are, shape ``(n, len(COLUMNS))``."""
        poses = uniform_poses(self.poses, np.random.default_rng([self.seed, 0]))
        scores = [
            score(
                designed(self.scene, design, self.power, self.mount),
                poses,
                np.random.default_rng([self.seed, 1]),
            )
            for design in designs
        ]
        return np.array([dataclasses.astuple(found) for found in scores])

    def differences(self, there: dict[str, Any]) -> list[str]:
        """List where another study, as `as_object` gives it, differs."""
        ours = self.as_object()
        found = [
            f"{key} is {there[key]} there and {ours[key]} here"
            for key in ("power", "mount", "poses", "seed")
            if there[key] != ours[key]
        ]
        for key, values in ours["sweep"].items():
            if there["sweep"][key] != values:
                listed = (" ".join(map(str, lists)) for lists in (there["sweep"][key], values))
                found.append("{} is {} there and {} here".format(key, *listed))
        if there["scene"] != ours["scene"]:
            found += self.scene.differences(scene_from_settings(there["scene"], "of the study"))
        return found


@dataclass(frozen=True)
class DesignStore:
    """A study on disk, finished or not; sent to workers as it is.

    Parameters
    ----------
    path
        Folder of the store, absolute; every worker must see it.
    study
        What is scored.
    """

    path: Path
    study: Study

    @classmethod
    def create(cls, path: str | Path, study: Study) -> "DesignStore":
        """Open the unfinished or finished store of a study, or begin one.

        Parameters
        ----------
        path
            Folder, its name ending in ``.zarr``.
        study
            What is scored.

        Raises
        ------
        ValueError
            Where `path` holds anything else, or another study.
        """
        path = files.user_path(path).absolute()
        if path.suffix != ".zarr":
            raise ValueError(f"{KIND} {path}: it is a Zarr store; name it *.zarr")
        store = cls(path, study)
        if not path.exists():
            store.disk.create({"format": FORMAT, "study": study.as_object()})
            return store
        with store.disk.opening(FORMAT) as about:
            if differ := study.differences(about["study"]):
                raise ValueError(
                    f"{KIND} {path}: of another study: {'; '.join(differ)}; name another --output"
                )
        return store

    @property
    def disk(self) -> ChunkedRows:
        """Where the rows lie."""
        shape = len(self.study.sweep.designs()), len(COLUMNS)
        return ChunkedRows(self.path, shape, CHUNK_DESIGNS, KIND, COMMAND)

    @property
    def chunks(self) -> range:
        """The numbers of the chunks."""
        return self.disk.chunks

    def thread_bytes(self) -> int:
        """Return what a thread that computes chunks holds, bytes."""
        most = max(self.study.sweep.detectors_per_side) ** 2
        return READING_BYTES * max(BLOCK_READINGS, most)

    def present(self) -> list[int]:
        """Return the chunks that have a file."""
        return self.disk.present()

    def fill(self, chunk: int) -> int:
        """Make sure that a chunk is there, as `ChunkedRows.fill`; return its designs."""
        return len(self.disk.fill(chunk, self.compute))

    def compute(self, chunk: int) -> Array:
        """Score the designs of a chunk, shape ``(m, len(COLUMNS))``."""
        return self.study.scored(self.study.sweep.designs()[self.disk.rows(chunk)])

    def rows(self) -> list[Row]:
        """Return every design with its score.

        Raises
        ------
        ValueError
            Where a chunk is missing or damaged.
        """
        scores = np.concatenate([self.disk.read(chunk) for chunk in self.chunks])
        return [
            Row(design, Score(*map(float, values)))
            for design, values in zip(self.study.sweep.designs(), scores, strict=True)
        ]


def write_csv(study: Study, rows: Sequence[Row], path: Path) -> None:
    """Write rows as CSV, whole or not at all; each names what it depends on.

    Parameters
    ----------
    study
        Of the rows.
    rows
        At least one.
    path
        The file.
    """
    origin = {
        "scene": study.scene.name,
        "fingerprint": study.scene.fingerprint,
        "power": study.power,
        "mount": study.mount,
        "poses": study.poses,
        "seed": study.seed,
    }
    lines = [{**origin, **row.values()} for row in rows]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    files.write_text(path, text.getvalue())
