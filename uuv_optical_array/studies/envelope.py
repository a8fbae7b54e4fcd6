"""``uuv_array study envelope``: measure in which trouble a follower keeps or loses its leader.

Run the closed loop of vehicles, sea, lamp, array, estimator, track and control law in one kind of
trouble after the other: lamps and water that change, clouds, darkness, leaders that turn, stop or
dash, currents, starts off the station, other lamps, formations. A run is kept where the follower
was never farther than 1 m off its station since the trouble began. It is lost where in the end,
though the lamp shines, the follower searches or is farther off than half the station's distance to
the lamp, or where false poses steer it. All other runs strayed. A frame is false where its track is
off by more than six of its own standard deviations. A run is silent if false poses steer it in the
end and the state does not say that the lamp may be another one.

  uuv_array study envelope                                      every kind, ten seeds each
  uuv_array study envelope --kinds darkness,turn_20 --seeds 3   a group and a kind
  uuv_array study envelope --vehicle bluerov2 --station=-6,0,0
  uuv_array study envelope --draw-sea                  other lamps, waters, arrays
Ctrl-C ends it early and reports the kinds it has.
"""

import argparse
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.control.fleet import Follower
from uuv_optical_array.control.following import Following
from uuv_optical_array.control.formation_settings import STATION, FormationSettings
from uuv_optical_array.control.vehicles.models import Model
from uuv_optical_array.core.processes import spread
from uuv_optical_array.core.settings import Place, Quantity, Setting
from uuv_optical_array.core.storage.formats import cell, columns
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.plots.style import mark, new_figure, plain_log_ticks, save
from uuv_optical_array.studies.closed_loops.figures import KEPT_M, figures
from uuv_optical_array.studies.closed_loops.kinds import kinds_named
from uuv_optical_array.studies.closed_loops.runs import ALONE, Kind, Run, run_kind
from uuv_optical_array.studies.shared.results import until_interrupted

COLOURS: dict[str, str] = {"kept": "#2c9c5a", "strayed": "#e0a800", "lost": "#c8401e"}
FALSE_SHARE = 0.001  # of the frames, from which a picture shows false ones that steered
FARTHEST_M = 60.0  # of the picture
COLUMNS = {
    "kind": "kind",
    "kept": "kept",
    "strayed": "strayed",
    "lost": "lost",
    "off_m": "off (m)",
    "end_m": "end (m)",
    "back": "back",
    "back_s": "after (s)",
    "false": "false",
    "false_steered": "steered",
    "silent": "silent",
    "states": "states",
}


def measure(
    kinds: Sequence[Kind],
    seeds: int,
    first: int,
    vehicle: Model,
    processes: int | None = None,
    follow: Callable[[FormationSettings], Following] = Following,
    drawn_sea: bool = False,
) -> Iterator[dict[str, Any]]:
    """Yield the `figures` of each kind, of so many seeds from the `first` on.

    Where seas are to be drawn, each run has its own, of the scene's prior.
    """
    scenes = dict.fromkeys(kind.scene for kind in kinds)
    estimators = {scene: Estimator(load_scene(scene)).wait() for scene in scenes}

    def work(i: int) -> list[Run]:
        kind = kinds[i // seeds]
        seed = first + i % seeds
        return run_kind(kind, seed, vehicle, estimators[kind.scene], follow, drawn_sea)

    count = len(kinds) * seeds
    runs = progress.over(spread(work, count, processes), "run", count)
    for kind in kinds:
        yield figures(kind, [next(runs) for _ in range(seeds)])


def report(rows: Sequence[dict[str, Any]]) -> str:
    """Return the kinds as a table, a part for each group."""

    def words(value: Any) -> str:
        return " ".join(value) if isinstance(value, list) else cell(value)

    lines = columns(
        [[*COLUMNS.values()], *([words(row[key]) for key in COLUMNS] for row in rows)]
    ).splitlines()
    text, group = [lines[0]], ""
    for row, line in zip(rows, lines[1:], strict=True):
        if row["group"] != group:
            group = row["group"]
            text += ["", group]
        text.append(line)
    return "\n".join(text)


def envelope(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Say in words within which limits no run was lost, by what the kinds tried."""
    by_name = {row["kind"]: row for row in rows}

    def until(begin: str, end: str = "") -> str:
        """Return the largest value below which no kind lost a run, and the first that did."""
        values = {
            float(name.removeprefix(begin).removesuffix(end)): row
            for name, row in by_name.items()
            if name.startswith(begin) and name.endswith(end)
        }
        held = "none"
        for value in sorted(values):
            row = values[value]
            if row["lost"]:
                return f"{held}; {value:g}: {row['lost']} of {row['runs']} lost"
            held = f"up to {value:g}, off by {row['off_m']:.2g} m at most"
        return held if values else ""

    lines = {
        "turn through 90 deg (deg/s)": until("turn_"),
        "speed of the leader (m/s)": until("speed_"),
        "darkness, leader straight on (s)": until("dark_", "_straight"),
        "darkness, leader on its path (s)": until("dark_", "_path"),
        "darkness, leader stopped (s)": until("dark_", "_stopped"),
        "chain of three, turn (deg/s)": until("chain_"),
    }
    starts = [row for name, row in by_name.items() if name.startswith("start_")]
    told = [
        f"{row['kind'].removeprefix('start_')} {row['runs'] - row['lost']} of {row['runs']}"
        + ("" if row["back_s"] is None else f" within {row['back_s']:.0f} s")
        for row in starts
    ]
    lines["found from the start"] = ", ".join(told)
    width = max(map(len, lines))
    return [f"{name:<{width}}  {text}" for name, text in lines.items() if text]


def draw(rows: Sequence[dict[str, Any]], about: str) -> Any:
    """Draw what became of the runs, and how far off they were, a row for each kind."""
    shown = _in_columns(rows)
    figure = new_figure(16, 2.4 + 0.235 * max(14, *map(len, shown)))
    axes = figure.subplots(1, 2 * len(shown), width_ratios=(1, 3) * len(shown), squeeze=False)[0]
    for part, shares, distances in zip(shown, axes[::2], axes[1::2], strict=True):
        _draw_part(part, max(map(len, shown)), shares, distances)
    names = {
        "kept": f"kept: never farther than {KEPT_M:g} m off",
        "strayed": "strayed: farther, not lost",
        "lost": "lost",
    }
    handles = [mark(names[name], "s", color=colour, ms=11) for name, colour in COLOURS.items()]
    handles.append(mark("farthest off since it began, of all seeds", "s", color="0.75", ms=11))
    handles.append(mark("off in the end, worst seed", "D", color="k", ms=6))
    handles.append(
        mark(f"false poses steered, over {100 * FALSE_SHARE:g} %", "x", color="k", ms=8, mew=2)
    )
    figure.legend(handles=handles, loc="outside lower center", ncols=6, fontsize=10)
    figure.suptitle(f"What a follower keeps and loses: {about}", fontsize=13)
    return figure


def _in_columns(rows: Sequence[dict[str, Any]]) -> list[list[dict[str, Any] | str]]:
    """Return rows below the titles of their groups, in up to three columns of whole groups."""
    lines: list[dict[str, Any] | str] = []
    begins = []
    for row in rows:
        if row["group"] not in lines:
            begins.append(len(lines))
            lines.append(row["group"])
        lines.append(row)
    count = min(1 + len(lines) // 40, 3)
    cuts = []
    for i in range(1, count):
        off = [abs(begin - len(lines) * i / count) for begin in begins]
        cuts.append(begins[off.index(min(off))])
    cuts = sorted({*cuts} - {0})
    return [lines[i:j] for i, j in zip([0, *cuts], [*cuts, len(lines)], strict=True)]


def _draw_part(
    part: Sequence[dict[str, Any] | str], lines: int, shares: Any, distances: Any
) -> None:
    """Draw a column of kinds on two axes, of as many lines as the longest has."""
    labels = []
    distances.set(xscale="log", xlim=(0.02, FARTHEST_M))
    for y, row in enumerate(part):
        if isinstance(row, str):
            labels.append(row)
            for axes in (shares, distances):
                axes.axhspan(y - 0.5, y + 0.5, color="0.93", lw=0)
            continue
        labels.append(row["kind"])
        left, worst = 0.0, "kept"
        for name, colour in COLOURS.items():
            share = row[name] / row["runs"]
            shares.barh(y, share, left=left, color=colour, height=0.8)
            left, worst = left + share, name if share else worst
        colour = COLOURS[worst]
        distances.barh(y, row["off_m"], color=colour, alpha=0.45, height=0.8)
        distances.plot(row["end_m"], y, "D", color="k", ms=4.5)
        if row["false_steered"] > FALSE_SHARE * row["frames"]:
            distances.plot(FARTHEST_M / 1.2, y, "x", color="k", ms=7, mew=2)
    shares.set(xlim=(0, 1), xticks=[], xlabel="runs")
    distances.set(xlabel="off its station (m)", yticks=[])
    plain_log_ticks(distances.xaxis)
    distances.axvline(KEPT_M, color="k", lw=0.8, ls=":")
    distances.grid(axis="x", alpha=0.4)
    distances.set_axisbelow(True)
    shares.set_yticks(range(len(part)), labels, fontsize=9)
    for row, label in zip(part, shares.get_yticklabels(), strict=True):
        if isinstance(row, str):
            label.set_fontweight("bold")
    for axes in (shares, distances):
        axes.set_ylim(lines - 0.5, -0.5)
        axes.tick_params(axis="y", length=0)


def at_station(kinds: Sequence[Kind], station_m: Place) -> list[Kind]:
    """Return kinds with another station where there is one follower; the others as they are."""
    alone = (Follower(1, station_m),)
    return [
        dataclasses.replace(kind, fleet=alone) if kind.fleet is ALONE else kind for kind in kinds
    ]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    about = "kinds, or groups of them (default: all)"
    parser.add_argument("--kinds", metavar="NAME,...", help=about)
    options.add_number(parser, "seeds", Quantity("runs of each kind", "", 1, 1e4), 10)
    models = Setting(Model, Quantity("model of the followers"), "kinematic", False)
    options.add_setting(parser, "vehicle", models)
    station = Setting(Place, STATION, FormationSettings.station_m, False)
    options.add_setting(parser, "station", station)
    about = "draw each run's sea, lamp and array from the scene's prior; else they are the scene's"
    parser.add_argument("--draw-sea", action="store_true", help=about)
    cores = Quantity("processes that share the runs (default: one for each core)", "", 1, 1000)
    options.add_number(parser, "processes", cores, None, int)
    options.add_seed(parser)
    options.add_json(parser)
    outputs.add_picture(parser, "envelope.png")


def run(args: argparse.Namespace) -> int:
    """Run the study, print and draw it."""
    output = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    with options.checking_options():
        kinds = at_station(kinds_named(args.kinds), FormationSettings(args.station).station_m)
    count, seed, vehicle = args.seeds, args.seed, args.vehicle
    measured = measure(kinds, count, seed, vehicle, args.processes, drawn_sea=args.draw_sea)
    rows, complete = until_interrupted(measured)
    at = ", ".join(f"{value:g}" for value in args.station)
    runs = "run" if count == 1 else "runs"
    sea = ", drawn seas" if args.draw_sea else ""
    about = f"{vehicle}, station [{at}] m{sea}, {count} {runs} a kind, seeds from {seed}"
    save(draw(rows, about), output)
    words = envelope(rows)
    result = {"vehicle": vehicle, "station_m": list(args.station), "seed": seed, "seeds": count}
    result |= {
        "drawn_sea": args.draw_sea,
        "complete": complete,
        "kinds": rows,
        "envelope": words,
        "picture": str(output),
    }
    text = "\n\n".join(
        [about, report(rows), *(["\n".join(words)] if words else []), f"picture: {output}"]
    )
    return outputs.finish(args, result, text, complete, "the table ends where the work ended")
