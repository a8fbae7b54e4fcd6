"""``uuv_array peers``: match and simulate, measured against what else a user would reach for."""

import argparse
import contextlib
import importlib.util
import json
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from matplotlib.figure import Figure

from uuv_optical_array import peers
from uuv_optical_array.commands.parser import (
    INTERRUPTED,
    Subparsers,
    add_command,
    add_json,
    add_scene,
    bar,
)
from uuv_optical_array.core import files
from uuv_optical_array.core.settings import Quantity, check
from uuv_optical_array.estimation.table.signature_table import grid_axes
from uuv_optical_array.forward import light_batch as bulk
from uuv_optical_array.forward.light import lamp_in_body
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, load_scene
from uuv_optical_array.plots.follow import save

DESCRIPTION = """\
Exact search by spectral angle against Spectral Python, scikit-learn, SciPy, NumPy and faiss, on
signatures of random poses of the scene; then the light at very many random poses, against the
exponentials alone. Everything is timed in turns within this run, on one thread where threadpoolctl
is installed. A peer that is not installed is named and left out: pip install -e '.[peers]'."""

EPILOG = """\
examples:
  uuv_array peers                              10,000 to a million signatures; two minutes
  uuv_array peers --rows 1e7 --poses 0         ten million, some 4 GB; no simulation
  uuv_array peers --rows 1e3 1e4 1e5 1e6 1e7 --output peers.png
  uuv_array peers --rows 1e6 --json            one JSON object for programs

A peer's answer is exact where it names a row that is nearest by exact fractions, in every query
that was checked and in every hard case: a row 1e-9 rad away beside one 4e-9 rad away, equal rows, a
query of length 1e200, a zero row and a zero query (which have no angle; only a refusal is right).
Batches have 1,000 queries, fewer for a peer where they would take more than 1e8 angles; every
figure is per query."""

ROWS = Annotated[int, Quantity("signatures to search", "", 500, 30_000_000)]
POSES = Annotated[int, Quantity("random poses to simulate", "", 0, 4_000_000)]
SEED = Annotated[int, Quantity("of the random numbers", "", 0, 2**32 - 1)]
QUERIES, SEARCH_ROUNDS, LIGHT_ROUNDS = 512, 7, 11
COLOURS = ["#1f6fb4", "#444444", "#8c6bb1", "#2a9d5c", "#c8401e", "#e08a00"]


def add_parser(subparsers: Subparsers) -> None:
    """Add the subcommand."""
    parser = add_command(
        subparsers,
        "peers",
        run,
        "measure search and simulation against other libraries",
        DESCRIPTION,
        EPILOG,
    )
    add_scene(parser, "reference")
    parser.add_argument(
        "--rows",
        nargs="+",
        type=float,
        default=[1e4, 1e5, 1e6],
        metavar="N",
        help="signatures to search (default: 1e4 1e5 1e6)",
    )
    parser.add_argument(
        "--poses", type=float, default=1e6, metavar="N", help="poses to simulate (default: 1e6)"
    )
    parser.add_argument("--seed", type=int, default=1, help="random numbers (default: 1)")
    parser.add_argument("--output", type=Path, metavar="PNG", help="draw time against rows too")
    add_json(parser)


def one_thread() -> contextlib.AbstractContextManager[Any]:
    """Keep every library to one thread, where that can be said to all of them."""
    if importlib.util.find_spec("threadpoolctl") is None:
        return contextlib.nullcontext()
    for module in peers.NEEDS.values():  # what is not loaded cannot be limited
        with contextlib.suppress(ImportError):
            importlib.import_module(module)
    from threadpoolctl import threadpool_limits

    return threadpool_limits(1)


def search(scene: Scene, rows: int, rng: np.random.Generator, verdicts: Any) -> dict[str, Any]:
    """Compare all peers on one table; returns the figures of each, by name."""
    table = peers.signatures(scene, rows, rng, lambda blocks: bar(blocks, "block"))
    queries = peers.signatures(scene, QUERIES, rng)
    builders = {name: peers.BUILDERS[name] for name in verdicts}
    answers = peers.compare(
        builders, table, queries, SEARCH_ROUNDS, progress=lambda rounds: bar(rounds, "round")
    )
    return {"rows": rows, "peers": figures(answers, verdicts)}


def figures(
    answers: dict[str, peers.Answers], verdicts: dict[str, dict[str, str]]
) -> dict[str, Any]:
    """Return medians, ratios to ours and exactness, by peer."""
    ours = answers[peers.OURS]
    query, batch = np.median(ours.query_s), np.median(ours.batch_s)
    return {
        name: {
            "query_us": float(np.median(each.query_s) * 1e6),
            "ratio": float(np.median(each.query_s) / query),
            "batch_us": float(np.median(each.batch_s) * 1e6),
            "batch_ratio": float(np.median(each.batch_s) / batch),
            "batch_queries": each.batch_queries,
            "build_s": each.build_s,
            "missed": each.missed,
            "checked": each.checked,
            "exact": each.missed == 0
            and all(words.startswith("right") for words in verdicts[name].values()),
        }
        for name, each in answers.items()
    }


def simulate(scene: Scene, count: int, rng: np.random.Generator) -> dict[str, Any]:
    """Time the light at random poses, and the exponentials of as many readings."""
    start = time.perf_counter()
    fast = bulk.installed()
    models = {"numpy": ForwardModel(scene, compiled=False)}
    if fast:
        models["compiled"] = ForwardModel(scene, compiled=True)
    load_s = time.perf_counter() - start
    low, high = np.transpose([axis[[0, -1]] for axis in grid_axes(scene.table)])
    poses = rng.uniform(low, high, (count, 5))
    side = scene.array.detectors_per_side
    exponents = rng.uniform(-20, 0, (count, side, side))
    images = np.empty_like(exponents)
    whole = slice(0, max(1, count // 10))  # all at once takes 3 kB a pose
    times: dict[str, list[float]] = {}

    def timed(name: str, work: Any, share: float = 1.0) -> None:
        begin = time.perf_counter()
        work()
        times.setdefault(name, []).append((time.perf_counter() - begin) / share)

    for _ in bar(range(LIGHT_ROUNDS + 1), "round"):
        timed("floor", lambda: np.exp(exponents, out=images))
        timed("fresh floor", lambda: np.exp(exponents))
        for name, model in models.items():
            timed(name, lambda model=model: model.write_light(images, poses))
            timed(f"fresh {name}", lambda model=model: model.light(poses))
        timed(
            "all at once",
            lambda: models["numpy"].light_by_lamp(*lamp_in_body(poses[whole])),
            len(poses[whole]) / count,
        )
    # The first round warms up. Ratios are those within a round: the machine's load changes.
    rounds = {name: np.array(values[1:]) for name, values in times.items()}
    median = {name: float(np.median(values)) for name, values in rounds.items()}

    def ratio(name: str, to: str) -> float:
        return float(np.median(rounds[name] / rounds[to]))

    result: dict[str, Any] = {
        "poses": count,
        "detectors": side * side,
        "floor_s": median["floor"],
        "fresh_floor_s": median["fresh floor"],
        "load_s": load_s if fast else None,
    }
    for name in ("all at once", *models):
        result[name] = {
            "poses_per_s": count / median[name],
            "times_floor": ratio(name, "floor"),
        }
        if f"fresh {name}" in median:
            result[name]["fresh_poses_per_s"] = count / median[f"fresh {name}"]
            result[name]["fresh_times_floor"] = ratio(f"fresh {name}", "fresh floor")
    if fast:
        result["compiled_speedup"] = ratio("numpy", "compiled")
    return result


def report_search(found: dict[str, Any]) -> str:
    """Return one table's figures in words."""
    lines = [
        "",
        f"{found['rows']:,} signatures: median time of a query, single and in a batch",
        f"  {'':18}{'single':>11} {'/ ours':>8}  {'batch':>11} {'/ ours':>8}  {'of':>5}   missed",
    ]
    for name, each in found["peers"].items():
        lines.append(
            f"  {name:18}{each['query_us']:8,.0f} us {each['ratio']:8,.1f}  "
            f"{each['batch_us']:8,.1f} us {each['batch_ratio']:8,.1f}  {each['batch_queries']:5}"
            f"   {each['missed']} of {each['checked']}"
        )
    return "\n".join(lines)


def report_verdicts(verdicts: dict[str, dict[str, str]]) -> str:
    """Return what each peer answers wrongly in the hard cases."""
    lines = ["", "wrong in hard cases, on 10,000 signatures"]
    for name, words in verdicts.items():
        wrong = [f"{what}: {said}" for what, said in words.items() if not said.startswith("right")]
        lines.append(f"  {name:18}{'; '.join(wrong) or 'nothing'}")
    return "\n".join(lines)


def report_light(found: dict[str, Any]) -> str:
    """Return the simulation's figures in words."""
    lines = [
        "",
        f"{found['poses']:,} random poses of {found['detectors']} detectors; "
        f"the floor is np.exp of as many readings: {found['floor_s'] * 1e3:.0f} ms",
        f"  {'':18}{'poses per s':>12} {'x floor':>9}    with new arrays on both sides",
    ]
    names = {"all at once": "NumPy, all at once", "numpy": "NumPy, in blocks", "compiled": "Numba"}
    for key, name in names.items():
        if each := found.get(key):
            line = f"  {name:18}{each['poses_per_s']:12,.0f} {each['times_floor']:9.1f}"
            if "fresh_times_floor" in each:
                line += f" {each['fresh_poses_per_s']:14,.0f} {each['fresh_times_floor']:9.1f}"
            lines.append(line)
    if "compiled" in found:
        lines.append(
            f"  Numba is {found['compiled_speedup']:.1f} times as fast as NumPy in blocks; "
            f"loading it took {found['load_s']:.2f} s"
        )
    return "\n".join(lines)


def draw(searches: list[dict[str, Any]], path: Path) -> None:
    """Draw the time of a query against the rows, single and in a batch, by peer."""
    figure = Figure(figsize=(12, 5.6), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for axes, key, title in zip(
        panels, ("query_us", "batch_us"), ("single query", "query of a batch"), strict=True
    ):
        for name, colour in zip(searches[0]["peers"], COLOURS, strict=False):
            rows = [found["rows"] for found in searches]
            each = [found["peers"][name] for found in searches]
            us = [one[key] for one in each]
            axes.plot(rows, us, color=colour, lw=2.5 if name == peers.OURS else 1.3)
            for label, exact, style in (
                (f"{name}, exact", True, {"marker": "o", "ms": 7}),
                (f"{name}, not exact", False, {"marker": "x", "ms": 9, "mew": 2}),
            ):
                chosen = [i for i, one in enumerate(each) if one["exact"] == exact]
                if chosen:
                    axes.plot(
                        [rows[i] for i in chosen],
                        [us[i] for i in chosen],
                        ls="",
                        color=colour,
                        label=label,
                        **style,
                    )
        axes.set(xscale="log", yscale="log", title=title, xlabel="signatures in the table")
        axes.grid(which="major", alpha=0.4)
    panels[0].set_ylabel("median time of a query (us)")
    panels[1].legend(loc="upper left", fontsize=9)
    figure.suptitle("Search by spectral angle; a cross gave a wrong answer or missed a refusal")
    save(figure, path)


def run(options: argparse.Namespace) -> int:
    """Measure, print, and draw where asked."""
    sizes = sorted({check(ROWS, _whole(rows), "--rows") for rows in options.rows})
    count = check(POSES, _whole(options.poses), "--poses")
    rng = np.random.default_rng(check(SEED, options.seed, "--seed"))
    scene = load_scene(options.scene)
    missing = peers.missing() + ([] if bulk.installed() else ["numba"])
    result: dict[str, Any] = {"scene": scene.name, "missing": missing}

    def say(text: str) -> None:
        if not options.json:
            print(text)

    if missing:
        say(f"not installed: {', '.join(missing)}; to compare: pip install -e '.[peers]'")
    searches: list[dict[str, Any]] = []
    code = 0
    with one_thread():
        try:
            few = peers.signatures(scene, 10_000, rng)
            cases = peers.hard_cases(few)
            verdicts = {
                name: {what: peers.verdict(build, case) for what, case in cases.items()}
                for name, build in peers.BUILDERS.items()
                if name not in missing
            }
            result["hard_cases"] = verdicts
            for rows in sizes:
                searches.append(search(scene, rows, rng, verdicts))
                say(report_search(searches[-1]))
            say(report_verdicts(verdicts))
            if count:
                result["simulation"] = simulate(scene, count, rng)
                say(report_light(result["simulation"]))
        except KeyboardInterrupt:
            say("interrupted: what is above stands")
            code = INTERRUPTED
    if searches:
        result |= {**searches[-1], "smaller": searches[:-1]}
    if options.json:
        print(json.dumps(result))
    if options.output is not None and searches:
        output = files.user_path(options.output)
        draw(searches, output)
        say(f"picture: {output}")
    return code


def _whole(value: float) -> float:
    """Turn 1e6 into a whole number; what is not one stays, to be refused by name."""
    return int(value) if value == value // 1 else value
