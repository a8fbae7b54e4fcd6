"""``make peers``: match and simulate, measured against what else a user would reach for."""

import argparse
import json
import sys
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from peers import light, report
from peers.exact import hard_cases, verdict
from peers.libraries import BUILDERS, missing
from peers.search import compare, figures, one_thread, signatures
from uuv_optical_array.cli import options, progress
from uuv_optical_array.core.settings import Quantity, check
from uuv_optical_array.core.storage import files
from uuv_optical_array.forward.scene import Scene, load_scene

DESCRIPTION = """\
Exact search by spectral angle against Spectral Python, scikit-learn, SciPy, NumPy and faiss, on
signatures of random poses of the scene; then the light at very many random poses, against the
exponentials alone. Everything is timed in turns within this run, on one thread where threadpoolctl
is installed. A peer that is not installed is named and left out: pip install -e '.[peers]'."""

EPILOG = """\
examples:
  make peers                                        10,000 to a million signatures; two minutes
  make peers ARGS='--rows 1e7 --poses 0'            ten million, some 4 GB; no simulation
  make peers ARGS='--rows 1e3 1e4 1e5 1e6 1e7 --output peers.png'
  make peers ARGS='--rows 1e6 --json'               one JSON object for programs

A peer's answer is exact where it names a row that is nearest by exact fractions, in every query
that was checked and in every hard case: a row 1e-9 rad away beside one 4e-9 rad away, equal rows, a
query of length 1e200, a zero row and a zero query (which have no angle; only a refusal is right).
Batches have 1,000 queries, fewer for a peer where they would take more than 1e8 angles; every
figure is per query."""

ROWS = Annotated[int, Quantity("signatures to search", "", 500, 30_000_000)]
POSES = Annotated[int, Quantity("random poses to simulate", "", 0, 4_000_000)]
SEED = Annotated[int, Quantity("of the random numbers", "", 0, 2**32 - 1)]
QUERIES, SEARCH_ROUNDS = 512, 7


def build_parser() -> argparse.ArgumentParser:
    """Return the parser."""
    parser = argparse.ArgumentParser(
        prog="peers",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.add_scene(parser, "reference")
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
    options.add_json(parser)
    return parser


def search(
    scene: Scene, rows: int, rng: np.random.Generator, verdicts: dict[str, dict[str, str]]
) -> dict[str, Any]:
    """Compare all peers on one table; returns the figures of each, by name."""
    table = signatures(scene, rows, rng, lambda blocks: progress.over(blocks, "block"))
    queries = signatures(scene, QUERIES, rng)
    builders = {name: BUILDERS[name] for name in verdicts}
    answers = compare(
        builders,
        table,
        queries,
        SEARCH_ROUNDS,
        progress=lambda rounds: progress.over(rounds, "round"),
    )
    return {"rows": rows, "peers": figures(answers, verdicts)}


def run(args: argparse.Namespace) -> int:
    """Measure, print, and draw where asked."""
    sizes = sorted({check(ROWS, _whole(rows), "--rows") for rows in args.rows})
    count = check(POSES, _whole(args.poses), "--poses")
    rng = np.random.default_rng(check(SEED, args.seed, "--seed"))
    scene = load_scene(args.scene)
    absent = missing()
    result: dict[str, Any] = {"scene": scene.name, "missing": absent}

    def say(text: str) -> None:
        if not args.json:
            print(text)

    if absent:
        say(f"not installed: {', '.join(absent)}; to compare: pip install -e '.[peers]'")
    searches: list[dict[str, Any]] = []
    code = 0
    with one_thread():
        try:
            cases = hard_cases(signatures(scene, 10_000, rng))
            verdicts = {
                name: {what: verdict(build, case) for what, case in cases.items()}
                for name, build in BUILDERS.items()
                if name not in absent
            }
            result["hard_cases"] = verdicts
            for rows in sizes:
                searches.append(search(scene, rows, rng, verdicts))
                say(report.search(searches[-1]))
            say(report.verdicts(verdicts))
            if count:
                result["simulation"] = light.simulate(
                    scene, count, rng, lambda rounds: progress.over(rounds, "round")
                )
                say(report.light(result["simulation"]))
        except KeyboardInterrupt:
            say("interrupted: what is above stands")
            code = options.INTERRUPTED
    if searches:
        result |= {**searches[-1], "smaller": searches[:-1]}
    if args.json:
        print(json.dumps(result))
    if args.output is not None and searches:
        output = files.user_path(args.output)
        report.draw(searches, output)
        say(f"picture: {output}")
    return code


def _whole(value: float) -> float:
    """Turn 1e6 into a whole number; what is not one stays, to be refused by name."""
    return int(value) if value == value // 1 else value


def main(args: list[str] | None = None) -> None:
    """Run the comparison; an error the user can mend ends it with one line and exit code 1."""
    try:
        sys.exit(run(build_parser().parse_args(args)))
    except (ValueError, OSError) as error:
        sys.exit(f"peers: {error}")


if __name__ == "__main__":
    main()
