"""What ``benchmarks/promises.py`` measures: each function returns figures, and measures once."""

import importlib
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

import frames
import numpy as np

from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.core.processes import spread
from uuv_optical_array.core.storage.files import shared_file
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.forward.working_volume import lit_poses
from uuv_optical_array.recording.images import read_recording
from uuv_optical_array.studies import accuracy as accuracy_study
from uuv_optical_array.studies import drives as drives_study
from uuv_optical_array.studies import envelope, robustness
from uuv_optical_array.studies.closed_loops.kinds import kinds_named as troubles_named
from uuv_optical_array.studies.mismatches.kinds import Kind
from uuv_optical_array.studies.mismatches.kinds import kinds_named as mismatches_named
from uuv_optical_array.studies.shared.errors import range_across_angle

SEED = 1  # of every study, as of its page
POSES, PLANAR_POSES = 2000, 1000
LAMP_POSES = 8000  # of several lamps, whose range has a standard error of 0.003 m by these
DRIVES, DRIVE_S, RATE_HZ = 24, 60.0, 10.0
FRAMES = 300  # of a kind of mismatch
FLIPS, BAGS = 30, 300
SEEDS = 2  # of a kind of closed loop
Figures = dict[str, float]
HERE = Path(__file__).parent

COMPILE = "from uuv_optical_array.estimation.fit_compiler import compile_fit; compile_fit()"
COMPILE_TABLES = (
    "from uuv_optical_array.estimation.signature_table import compile_tables; compile_tables()"
)
FIRST_POSE = """
import numpy as np
from uuv_optical_array import Estimator, ForwardModel, load_scene
scene = load_scene("follow")
image = ForwardModel(scene).expose([-4.5, 0.3, -0.2, 0.1, -0.15], np.random.default_rng(1))
print(*Estimator(scene).estimate(image).pose)
"""


@cache
def accuracy(name: str, shape: str, drawn: bool) -> Figures:
    """Return errors of single images, m and deg, beside bound and covariance."""
    scene = load_scene(name).with_shape(shape)
    count = PLANAR_POSES if shape == "planar" else LAMP_POSES if scene.lamps else POSES
    rng, model = np.random.default_rng(SEED), ForwardModel(scene)
    poses = lit_poses(model, count, rng)
    noise = np.random.default_rng((SEED, 2))
    images = accuracy_study.exposed(model, poses, SEED, drawn, False, noise)
    result = accuracy_study.measure(Estimator(scene).wait(), poses, images)
    range_m, across_m, angle_deg = range_across_angle(result["rms_error"].values())
    return {
        "range": range_m,
        "across": across_m,
        "angle": angle_deg,
        "ratio": max(result["ratio_to_bound"].values()),
        "nees": result["nees_mean"],
        "false": result["beyond_6_sigma"],
        "without a pose": result["without_pose"],
    }


@cache
def drives() -> Figures:
    """Return what tracks in drawn seas are off by."""
    estimator = Estimator(load_scene("follow")).wait()

    def driven(i: int) -> drives_study.Drive:
        rng = np.random.default_rng((SEED, i))
        return drives_study.drive(estimator, DRIVE_S, RATE_HZ, rng)

    result = drives_study.figures(list(spread(driven, DRIVES)))
    keys = {"false": "beyond_6_sigma", "nees": "nees_mean", "refused": "refused"}
    return {name: float(result[key]) for name, key in keys.items()}


@cache
def _false_of_kinds() -> dict[Kind, int]:
    """Return how many of `FRAMES` images of each kind of mismatch are false."""
    scene = load_scene("follow")
    estimator, kinds = Estimator(scene).wait(), mismatches_named(None, scene)

    def measured(i: int) -> int:
        (row,) = robustness.measure(estimator, kinds[i : i + 1], FRAMES, SEED)
        return int(row["beyond_6_sigma"])

    return dict(zip(kinds, spread(measured, len(kinds)), strict=True))


def mismatch(name: str) -> Figures:
    """Return how many of `FRAMES` images of a kind of mismatch are false."""
    return {"false": sum(n for kind, n in _false_of_kinds().items() if kind.name == name)}


def mismatches_within(within: bool, but: tuple[str, ...] = ()) -> Figures:
    """Return the same of all kinds that the prior covers, or of all others without some."""
    found = _false_of_kinds().items()
    return {"false": sum(n for kind, n in found if kind.within == within and kind.name not in but)}


@cache
def speed() -> Figures:
    """Return medians of the CPU time of a frame, in yardsticks, by the names of `frames`."""
    return {row.name: row.median_us / row.yardstick_us for row in frames.measure()}


@cache
def signatures() -> Figures:
    """Return what a million signatures cost, thousands of yardsticks, and `follow`'s table, s."""
    return {"million": frames.million_signatures().yardsticks / 1e3, "table": frames.table_s()}


@cache
def compiling() -> Figures:
    """Return the CPU time of compiling into an empty cache, over that of compiling a yardstick.

    It is that of `frames`, compiled before and after each.
    """
    units, spent = [_yardstick_compiled_s()], {}
    for name, program in (("fit", COMPILE), ("tables", COMPILE_TABLES)):
        with tempfile.TemporaryDirectory() as empty:
            spent[name] = _cpu_s(program, NUMBA_CACHE_DIR=empty)
        units.append(_yardstick_compiled_s())
    fit, tables = spent["fit"] / np.mean(units[:2]), spent["tables"] / np.mean(units[1:])
    return {"fit": float(fit), "tables": float(tables)}


def _yardstick_compiled_s() -> float:
    call = "; frames.yardstick(np.ones((6, 25)), np.ones(25), np.ones(5))"
    path = f"import sys; sys.path.append({str(HERE)!r}); "
    imports = f"{path}import frames; import numpy as np"
    return _cpu_s(imports + call) - _cpu_s(imports)


@cache
def first_pose() -> Figures:
    """Return the time until a program has its first pose where nothing is compiled yet, s."""
    with tempfile.TemporaryDirectory() as empty:
        begun = time.perf_counter()
        _python(FIRST_POSE, NUMBA_CACHE_DIR=empty)
        return {"s": time.perf_counter() - begun}


@cache
def relay(rate_hz: int) -> Figures:
    """Return the median latency of a pose beside that of a bare relay of the same process."""
    few = ["--processes=1", "--sides=5", f"--rates={rate_hz}", "--seconds=15"]
    program = [sys.executable, str(HERE / "latency.py"), "--methods=least_squares", *few]
    done = subprocess.run(program, capture_output=True, text=True, check=True)
    cells = done.stdout.splitlines()[2].split()
    return {"ratio": float(cells[importlib.import_module("latency").COLUMNS.index("ratio")])}


@cache
def flips() -> Figures:
    """Return what became of programs that found a flipped bit in what was compiled before."""
    Estimator(load_scene("follow")).wait()
    kept, rng = compilation.cache_folder(), np.random.default_rng(SEED)
    if kept is None:
        raise OSError("no folder to keep compiled code in; set NUMBA_CACHE_DIR to one")
    crashes = wrong = 0
    with tempfile.TemporaryDirectory() as scratch:
        home = Path(scratch)
        expected = _pose(_python(FIRST_POSE, NUMBA_CACHE_DIR=scratch))
        for i in range(FLIPS):
            shutil.rmtree(home / "compiled", ignore_errors=True)
            folder = shutil.copytree(kept, home / "compiled" / kept.name)
            files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
            files = [path for path in files if path.stat().st_size]
            content = bytearray(files[i % len(files)].read_bytes())
            content[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
            files[i % len(files)].write_bytes(content)
            try:
                found = _pose(_python(FIRST_POSE, NUMBA_CACHE_DIR=scratch))
                wrong += not np.allclose(found, expected, atol=1e-9)
            except subprocess.CalledProcessError:
                crashes += 1
    return {"crashes": crashes, "wrong": wrong}


@cache
def bags() -> Figures:
    """Return how many of `BAGS` damaged copies of the sample bag ended in another than a line."""
    sample, rng = shared_file("examples/sample/metadata.yaml").parent, np.random.default_rng(SEED)
    unclear = refused = 0
    with tempfile.TemporaryDirectory() as scratch:
        for i in range(BAGS):
            bag = shutil.copytree(sample, Path(scratch, f"{i}"))
            files = sorted(bag.iterdir(), key=lambda path: -path.stat().st_size)
            file = files[0 if i % 5 else 1]  # seldom the metadata
            file.write_bytes(damaged(file.read_bytes(), i, rng))
            try:
                read_recording(bag, load_scene("follow").array, poses_needed=False)
            except (ValueError, OSError) as error:
                refused += 1
                unclear += "\n" in str(error)
            except Exception:  # what a user would see as a traceback
                unclear += 1
            shutil.rmtree(bag)
    return {"unclear": unclear, "refused": refused}


def damaged(content: bytes, kind: int, rng: np.random.Generator) -> bytes:
    """Return content with a bit flipped, cut off, with a hole of zeros, or with more at its end."""
    at = int(rng.integers(len(content)))
    if kind % 4 == 0:
        return content[:at] + bytes([content[at] ^ 1 << int(rng.integers(8))]) + content[at + 1 :]
    if kind % 4 == 1:
        return content[:at]
    if kind % 4 == 2:
        return content[:at] + bytes(min(1000, len(content) - at)) + content[at + 1000 :]
    return content + rng.bytes(1000)


@cache
def closed_loop(names: str, drawn_sea: bool = False) -> Figures:
    """Return what became of followers in kinds of trouble of `study envelope`, between commas."""
    kinds = troubles_named(names)
    rows = list(envelope.measure(kinds, SEEDS, SEED, "kinematic", drawn_sea=drawn_sea))
    return {
        "lost": sum(row["lost"] for row in rows),
        "off": max(row["off_m"] for row in rows),
        "false": sum(row["false"] for row in rows) / sum(row["frames"] for row in rows),
        "steered": sum(row["false_steered"] for row in rows),
        "silent": sum(row["silent"] for row in rows),
    }


def _pose(printed: str) -> list[float]:
    return [float(word) for word in printed.split()]


def _cpu_s(code: str, **environment: str) -> float:
    """Run code in a process of its own; return its CPU time, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    _python(code, **environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _python(code: str, **environment: str) -> str:
    """Run code in a process of its own; return what it prints, CalledProcessError if it fails."""
    program = [sys.executable, "-c", code]
    variables = {**os.environ, **environment}
    done = subprocess.run(program, capture_output=True, text=True, check=True, env=variables)
    return done.stdout
