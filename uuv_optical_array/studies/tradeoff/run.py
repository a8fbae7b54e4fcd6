"""A run of the trade-off: what there is of it in a folder, and what is left."""

from collections.abc import Callable
from pathlib import Path

from uuv_optical_array.estimation.table.signature_table import Progress, SignatureTable
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.studies.results import Results
from uuv_optical_array.studies.tradeoff.measurement import measure
from uuv_optical_array.studies.tradeoff.plan import FRAMES, Group, plan
from uuv_optical_array.studies.tradeoff.results import (
    SETTINGS_CSV,
    TABLES_CSV,
    Measurement,
    Mode,
    Origin,
    TableCost,
)
from uuv_optical_array.studies.tradeoff.table_cost import table_cost


class TradeoffRun:
    """A run of measurements in a folder, finished or not.

    Parameters
    ----------
    scene, mode, seed
        What is measured.
    folder
        Where its CSV files lie; made where it is missing.

    Raises
    ------
    ValueError
        Where the folder holds those of another run.
    """

    def __init__(self, scene: Scene, mode: Mode, seed: int, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.scene, self.seed, self.folder = scene, seed, folder
        self.frames = FRAMES[mode]
        self.origin = Origin.here(scene, mode, self.frames, seed)
        self.settings = Results(folder / SETTINGS_CSV, Measurement, self.origin)
        self.tables = Results(folder / TABLES_CSV, TableCost, self.origin)
        self.groups = plan(scene, mode)

    @property
    def count(self) -> int:
        """How many settings there are to measure."""
        return sum(len(group.methods) for group in self.groups)

    def left(self) -> list[Group]:
        """Return what is not measured yet."""
        done = {
            (row.method, row.shape, row.detectors_per_side, row.steps)
            for row in self.settings.lines
        }
        return [
            group
            for group in self.groups
            if any(
                (method, group.shape, group.detectors_per_side, group.steps) not in done
                for method in group.methods
            )
        ]

    def measure(self, group: Group, progress: Progress = iter) -> None:
        """Measure a group and keep it; an interrupt keeps what was there."""
        own = self.scene.array
        on_table: Callable[[SignatureTable, float], None] | None = None
        if (group.shape, group.detectors_per_side) == (own.shape, own.detectors_per_side):
            on_table = self._keep_cost
        self.settings.append(measure(self.scene, group, self.frames, self.seed, progress, on_table))

    def _keep_cost(self, table: SignatureTable, build_s: float) -> None:
        steps = table.scene.table.x_m.number
        if steps not in [cost.steps for cost in self.tables.lines]:
            self.tables.append([table_cost(table, steps, build_s, self.folder)])
