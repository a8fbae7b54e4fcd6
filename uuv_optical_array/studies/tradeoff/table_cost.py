"""What a table costs the process that uses it, measured in a process of its own."""

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from uuv_optical_array.core.storage import yaml_text
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.table.disk import ABOUT, load_table, save_table
from uuv_optical_array.estimation.table.signature_table import SignatureTable
from uuv_optical_array.forward.scene import scene_from_settings
from uuv_optical_array.studies.tradeoff.results import TableCost, load_average

MB = 1e6


def _resident_mb() -> float:
    """Return the memory this process holds, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / MB


def _peak_mb() -> float:
    """Return the most memory this process ever held, MB; getrusage also counts its parent's."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    kilobytes = next(line for line in status.splitlines() if line.startswith("VmHWM:")).split()[1]
    return int(kilobytes) * 1024 / MB


def get_ready(folder: Path) -> dict[str, float]:
    """Open a table, make an estimator of it, and return what that took, by column.

    Parameters
    ----------
    folder
        The table.

    Returns
    -------
    dict
        ``load_s``, ``memory_mb`` and ``peak_mb`` of `TableCost`.
    """
    about = yaml_text.read(folder / ABOUT)
    scene = scene_from_settings(about["scene"], about["name"])
    before_mb, began = _resident_mb(), time.perf_counter()
    estimator = Estimator(load_table(folder, scene), "sam")
    load_s = time.perf_counter() - began
    memory_mb = _resident_mb() - before_mb
    del estimator
    # The kernel's two counters are not brought up to date together.
    peak_mb = max(_peak_mb() - before_mb, memory_mb)
    return {"load_s": load_s, "memory_mb": memory_mb, "peak_mb": peak_mb}


def table_cost(table: SignatureTable, steps: int, build_s: float, scratch: Path) -> TableCost:
    """Save a table, open it in a new process, and remove it.

    Parameters
    ----------
    table
        The table.
    steps, build_s
        As in `TableCost`.
    scratch
        Folder that has room for the table.

    Returns
    -------
    TableCost
        What was measured.

    Raises
    ------
    ValueError
        Where a process cannot open it, for lack of memory for instance.
    """
    with tempfile.TemporaryDirectory(prefix=".table.", dir=scratch) as folder:
        path = Path(folder) / "table"
        save_table(table, path)
        file_mb = sum(file.stat().st_size for file in path.iterdir()) / MB
        told = subprocess.run(
            [sys.executable, "-m", "uuv_optical_array.studies.tradeoff.table_cost", str(path)],
            capture_output=True,
            check=False,
            text=True,
        )
    if told.returncode:
        why = (told.stderr.splitlines() or [f"exit code {told.returncode}"])[-1]
        raise ValueError(f"table of {len(table.poses)} poses: a process cannot open it: {why}")
    found = json.loads(told.stdout)
    rows, load = len(table.poses), load_average()
    return TableCost(steps, rows, build_s, file_mb, load_average=load, **found)


if __name__ == "__main__":
    print(json.dumps(get_ready(Path(sys.argv[1]))))
