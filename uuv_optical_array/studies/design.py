"""``uuv_array study design``: sweep array and lamp, and say which design to build.

Sweep the array (shape, detectors, size, radius of curvature), the width of the lamp's beam and, in
a scene with `lamps`, their number, distance from the centre and tilt. Each design is scored by the
criteria of Eren et al. (2016), whether the signature tells 0.2 m and 10 deg apart 4 to 8 m behind
the lamp and how many detectors that takes, and by the Cramer-Rao bound over the working volume. The
scores go into a picture and a CSV beside it; the Pareto-optimal designs are printed. A design that
has a score in the CSV is not scored again, so the same command resumes an interrupted sweep.

  uuv_array study design                             the default scene, into follow.design.csv
  uuv_array study design --sweep width_m=0.3,0.4 detectors_per_side=5,7    some of it
  uuv_array study design --take 2                    all of it, and design 2 as a scene file
  uuv_array study design --scene leading_lights --sweep lamps=1,3 spread_m=0.2,0.4 tilt_deg=0,3
fronts: `fits` is of arrays no wider than the scene's, `resolved` of those of them that meet the
criterion at 4 m, `any` of all. A design is left out if another one has no more detectors and bounds
that are no more than 10 % larger. Ctrl-C ends it early and draws what there is.
"""

import argparse
import dataclasses
import functools
import operator
import sys
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from uuv_optical_array.cli import options, outputs
from uuv_optical_array.core.settings import Quantity, check
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.scene import save_scene, scene_from_settings
from uuv_optical_array.forward.working_volume import SPECIFICATION, volume_spread
from uuv_optical_array.plots import style
from uuv_optical_array.studies import design_sweep
from uuv_optical_array.studies.design_sweep import PAPER, Design, DesignStudy, ScoredDesign
from uuv_optical_array.studies.shared.results import STEP, Results
from uuv_optical_array.studies.shared.separation import THRESHOLD_DEG

CLEAR_SIGMAS = 3.0


def front(rows: Sequence[ScoredDesign]) -> list[ScoredDesign]:
    """Return the designs that represent all in detectors and bounds, fewest detectors first.

    One represents another that has no fewer and whose bounds are each at least its own over `STEP`.
    """
    kept: list[ScoredDesign] = []
    # A later design never represents an earlier one: that would need a smaller product.
    for row in sorted(rows, key=lambda row: (row.detectors, row.position_m * row.angle_deg)):
        most = STEP * row.position_m, STEP * row.angle_deg
        if not any(one.position_m <= most[0] and one.angle_deg <= most[1] for one in kept):
            kept.append(row)
    return sorted(kept, key=lambda row: (row.detectors, row.position_m))


@dataclass(frozen=True)
class Choice:
    """What a sweep offers: the Pareto-optimal designs among its scored ones."""

    study: DesignStudy
    rows: Sequence[ScoredDesign]

    @functools.cached_property
    def fronts(self) -> dict[str, list[ScoredDesign]]:
        """Fronts of what is no wider than the scene's array, of what resolves, and of all."""
        fits = [row for row in self.rows if row.width_m <= self.study.scene.array.width_m]
        resolved = [row for row in fits if row.resolved_at_4m]
        return {"fits": front(fits), "resolved": front(resolved), "any": front(self.rows)}

    @functools.cached_property
    def papers(self) -> list[ScoredDesign]:
        """The paper's array with the scene's lamps, where it is swept."""
        own = dataclasses.replace(Design.of(self.study.scene), **PAPER)
        return [row for row in self.rows if row.design == own]

    @functools.cached_property
    def numbered(self) -> list[ScoredDesign]:
        """Every design that is listed, once: the fronts in turn, then the paper's array."""
        on_fronts = [row for rows in self.fronts.values() for row in rows]
        return list(dict.fromkeys([*on_fronts, *self.papers]))

    def table(self, numbers: Collection[int] | None = None) -> str:
        """Return `numbered` as a table, or those of some numbers, from 1."""
        heads = ("position", "angle", "lit", "at 4 m", "4 to 8 m", "", "15 deg", "")
        width = max(51, 2 + max((len(row.label) for row in self.numbered), default=0))
        line = f"{{:>3}} {{:<{width}}}{{:>8}}{{:>7}}{{:>5}}{{:>12}}{{:>12}}{{:>7}}  {{:<9}}{{}}"
        units = ("m", "deg", "%", "deg", "deg", "sigma", "at", "front")
        lines = [line.format("no", "design", *heads), line.format("", "", *units)]
        for number, row in enumerate(self.numbered, start=1):
            if numbers is not None and number not in numbers:
                continue
            on_fronts = [name for name, rows in self.fronts.items() if row in rows] or ["none"]
            bounds = f"{row.position_m:.3f}", f"{row.angle_deg:.2f}", f"{100 * row.lit:.0f}"
            near = f"{row.shift_near_deg:.1f}, {row.yaw_near_deg:.1f}"
            far = f"{row.shift_deg:.1f}, {row.yaw_deg:.1f}", f"{row.sigmas:.1f}", row.resolved
            standing = ", ".join(on_fronts) + "; the paper's array" * row.is_papers_array
            lines.append(line.format(number, row.label, *bounds, near, *far, standing))
        return "\n".join(lines)

    @property
    def resolved_counts(self) -> tuple[int, int, int]:
        """How many meet the criterion at 4 m, from 4 to 8 m, and there beyond noise."""
        far = [row for row in self.rows if row.resolved_4_to_8m]
        clear = sum(row.sigmas >= CLEAR_SIGMAS for row in far)
        return sum(row.resolved_at_4m for row in self.rows), len(far), clear

    def as_object(self) -> dict[str, Any]:
        """Return plain values; None is not known, or has no bound."""
        at = {id(row): i for i, row in enumerate(self.rows)}
        return {
            **self.study.origin,
            "sweep": vars(self.study.sweep),
            "designs": [row.columns() for row in self.rows],
            "fronts": {name: [at[id(row)] for row in rows] for name, rows in self.fronts.items()},
            "numbered": [at[id(row)] for row in self.numbered],
            "papers_array": [i for i, row in enumerate(self.rows) if row.is_papers_array],
            "dropped": self.study.sweep.dropped(),
        }


def report(choice: Choice) -> str:
    """Return the designs that are listed, and how many meet the criterion."""
    near, far, clear = choice.resolved_counts
    return (
        f"{choice.table()}\n\n"
        f"{near} of {len(choice.rows)} designs tell 0.2 m and 10 deg apart by 15 deg at 4 m, "
        f"{far} from 4 to 8 m;\nof these, {clear} by {CLEAR_SIGMAS:g} or more standard "
        "deviations of their signature's noise"
    )


# Score, axis label, the specification, and what is known without light.
BOUNDS = {
    "position_m": ("bound on position, RMS (m)", float(SPECIFICATION[0]), volume_spread()[0]),
    "angle_deg": ("bound on angle, RMS (deg)", float(SPECIFICATION[3]), volume_spread()[1]),
}
# Where the shapes of a number of detectors are, how wide each is, and where labels end, of the
# distance between two numbers of detectors.
CENTRE: dict[Shape, float] = {"planar": -0.3, "curved": 0.04}
BAND = 0.3
LANE = 0.485
LABEL_GAP = 0.045  # between labels, of the height of the axes
CLOSE_UP_SIDE = 5


def draw(choice: Choice) -> Any:
    """Draw bounds against detectors, lamp, size and radius, and list the designs that fit."""
    study, rows = choice.study, choice.rows
    listed = [*choice.fronts["fits"], *choice.papers]
    named = {number: row for number, row in enumerate(choice.numbered, start=1) if row in listed}
    figure, mark, width_m = style.new_figure(14, 13), style.mark, study.scene.array.width_m
    parts: Any = figure.subfigures(3, 1, height_ratios=[5, 4, 2.4])
    for axes, name in zip(parts[0].subplots(1, 2), BOUNDS, strict=True):
        _all_designs(axes, choice, named, name)
    by_beam, by_radius, criterion = parts[1].subplots(1, 3)
    _close_up(by_beam, by_radius, choice)
    _dots(criterion, [min(row.shift_deg, row.yaw_deg) for row in rows], rows, "angle_deg")
    _levels(criterion, "angle_deg")
    criterion.axvline(THRESHOLD_DEG, color="k", lw=1)
    criterion.set_xlabel("least spectral angle of 0.2 m and 10 deg, 4 to 8 m (deg)")
    criterion.set_title(f"the paper's criterion, {THRESHOLD_DEG:g} deg, and the bound")
    left, right = parts[2].subplots(1, 2, gridspec_kw={"width_ratios": [2.2, 1]})
    text = choice.table(named)
    size = 7.5 * min(1.0, 135 / max(map(len, text.splitlines())))
    style.write_table(left, text, size, 1.3)
    right.set_axis_off()
    handles = [
        *(mark(f"{s}; wider arrays to the right", color=c) for s, c in style.SHAPE_COLOURS.items()),
        mark(f"front 'fits': no wider than {width_m:g} m, numbered", "", color="k", lw=1.2),
        mark("front 'any': of any width", "", color="k", lw=1.2, ls="--"),
        mark("specification of the paper", "", color=style.SPECIFIED, lw=1.4, ls="--"),
        mark("no measurement at all", "", color="0.5", lw=1.4, ls=":"),
    ]
    right.legend(handles=handles, loc="upper left", fontsize=10, frameon=False)
    how = f"{study.power}; mount: {study.mount}; {study.poses} poses, seed {design_sweep.SEED}"
    title = f"What to build: {len(rows)} designs of array and lamp, scene {study.scene.name}"
    figure.suptitle(f"{title}\nlamp power: {how}", fontsize=13)
    return figure


def _levels(axes: Any, name: str) -> None:
    """Draw the specification and what is known without light, and set up the axis of bounds."""
    label, wanted, free = BOUNDS[name]
    axes.axhline(wanted, color=style.SPECIFIED, ls="--", lw=1.4, zorder=1)
    axes.axhline(free, color="0.5", ls=":", lw=1.4, zorder=1)
    axes.set(yscale="log", ylabel=label)
    style.plain_log_ticks(axes.yaxis)
    axes.grid(alpha=0.3, lw=0.5)


def _dots(axes: Any, x: Sequence[float], rows: Sequence[ScoredDesign], name: str) -> None:
    """Draw designs as pale dots, coloured by their shape."""
    colours = [style.SHAPE_COLOURS[row.shape] for row in rows]
    y = [getattr(row, name) for row in rows]
    axes.scatter(x, y, s=9, c=colours, alpha=0.3, lw=0, zorder=2)


def _all_designs(axes: Any, choice: Choice, named: dict[int, ScoredDesign], name: str) -> None:
    """Draw every design by its number of detectors, the fronts, and the numbers of the named."""
    rows, bound = choice.rows, operator.attrgetter(name)
    sides = sorted({row.detectors_per_side for row in rows})
    widths = sorted({row.width_m for row in rows})

    def place(row: ScoredDesign) -> float:
        share = (widths.index(row.width_m) + 0.5) / len(widths) - 0.5
        return sides.index(row.detectors_per_side) + CENTRE[row.shape] + BAND * share

    _dots(axes, [place(row) for row in rows], rows, name)
    _levels(axes, name)
    for i in range(1, len(sides)):
        axes.axvline(i - 0.5, color="0.85", lw=0.8, zorder=0)
    axes.grid(visible=False, axis="x")
    axes.set_xticks(range(len(sides)), [f"{n} x {n}" for n in sides])
    axes.set(xlim=(-0.5, len(sides) - 0.5), xlabel="detectors")
    for front_name, dashes in (("fits", "-"), ("any", "--")):
        # Of each number of detectors the best; the last of a key stays.
        on_front = sorted(choice.fronts[front_name], key=bound, reverse=True)
        best = {row.detectors_per_side: row for row in on_front}
        line = [best[side] for side in sorted(best)]
        axes.plot([*map(place, line)], [*map(bound, line)], "k", ls=dashes, lw=1.2, zorder=2.5)
    for i, side in enumerate(sides):
        of_side = {n: row for n, row in named.items() if row.detectors_per_side == side}
        points = {n: (place(row), bound(row)) for n, row in of_side.items()}
        for n, row in of_side.items():
            colour = style.SHAPE_COLOURS[row.shape]
            axes.plot(*points[n], "o", color=colour, ms=6, mec="k", zorder=3)
        style.number_points(axes, points, (i + 0.5 + LANE) / len(sides), LABEL_GAP, ha="right")


def _close_up(by_beam: Any, by_radius: Any, choice: Choice) -> None:
    """Draw one number of detectors: against the lamp's beam, and against sphere or lamps."""
    own, rows = Design.of(choice.study.scene), choice.rows
    wanted = dataclasses.replace(own, detectors_per_side=CLOSE_UP_SIDE)
    alike = ["detectors_per_side", "width_m", "beam_sigma_deg"]

    def nearest(*names: str) -> ScoredDesign:
        return min(rows, key=lambda row: [abs(vars(row)[n] - vars(wanted)[n]) for n in names])

    # The values that stand for all.
    stands = {name: getattr(nearest(name), name) for name in alike}
    ring = nearest(*design_sweep.RING)
    stands |= {"ring": ring.ring, "lamps": ring.lamps}
    side, width, sigma = (stands[name] for name in alike)
    array, beam = f"{side} x {side} on {width:g} m", f"beam of {sigma:g} deg"

    def same(*names: str) -> list[ScoredDesign]:
        """Return designs with the detectors that stand for all, and more alike."""
        return [r for r in rows if all(getattr(r, n) == stands[n] for n in (alike[0], *names))]

    _lines(by_beam, same("width_m", "ring", "lamps"), "beam_sigma_deg", "radius_m",
           "radius {:g} m", "viridis")  # fmt: skip
    by_beam.set(xlabel="standard deviation of the beam (deg)", title=array)
    if len(choice.study.sweep.lamps) > 1:
        of_array = [r for r in same("width_m", "beam_sigma_deg") if r.radius_m == own.radius_m]
        _lines(by_radius, of_array, "lamps", "ring", "{}", "viridis")
        label = "lamps, so far from their middle and turned outwards"
        by_radius.set(xlabel=label, title=f"{array}, {beam}")
        return
    of_sigma = [row for row in same("beam_sigma_deg", "ring", "lamps") if row.radius_m]
    _lines(by_radius, of_sigma, "radius_m", "width_m", "{:g} m wide", "cividis")
    by_radius.set(xlabel="radius of the sphere (m)", title=f"{side} x {side}, {beam}")


def _lines(
    axes: Any, rows: Sequence[ScoredDesign], x_name: str, group_name: str, label: str, cmap: str
) -> None:
    """Draw the bound on the position against a setting, a line for each value of another one."""
    from matplotlib.ticker import NullLocator

    lines: dict[Any, list[tuple[float, float]]] = {}
    for row in rows:
        point = getattr(row, x_name), row.position_m
        lines.setdefault(getattr(row, group_name), []).append(point)
    values = sorted(lines.keys() - {None})
    colours = [*style.shades(cmap, 0, 0.88, len(values)), style.SHAPE_COLOURS["planar"]]
    for value, colour in zip([*values, None], colours, strict=True):
        if value in lines:
            x, y = np.transpose(sorted(lines[value]))
            text = "planar" if value is None else label.format(value)
            axes.plot(x, y, "o-", color=colour, lw=1.5, ms=4, label=text)
    _levels(axes, "position_m")
    axes.set_xscale("log")
    ticks = sorted({getattr(row, x_name) for row in rows})
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.xaxis.set_minor_locator(NullLocator())
    if rows:
        few = len(lines) < 7
        axes.legend(fontsize=9 if few else 6, ncols=1 if few else 2, framealpha=0.85)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "follow")
    about = f"values of {', '.join(design_sweep.SWEPT)} (default: a grid about the scene's own)"
    parser.add_argument("--sweep", nargs="+", default=[], metavar="NAME=VALUE,...", help=about)
    scored = parser.add_argument_group("how it is scored")
    options.add_settings(scored, DesignStudy, *design_sweep.HOW)
    written = parser.add_argument_group("what is written")
    about = "picture, with the CSV of every design beside it (default: SCENE.design.png here)"
    outputs.add_picture(written, None, about=about)
    about = "write design NO of the table as a scene, too"
    written.add_argument("--take", type=options.whole_number, metavar="NO", help=about)
    options.add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Score what is not scored yet, and print, write and draw it."""
    scene = options.scene_of(args)
    with options.checking_options():
        sweep = design_sweep.sweep_of(scene, args.sweep)
    study = DesignStudy(scene, sweep, **options.settings_of(args, DesignStudy, *design_sweep.HOW))
    picture = args.output or f"{scene.name}.design.png"
    picture = outputs.file_to_write(picture, "--output", outputs.PICTURE)
    csv = outputs.file_to_write(picture.with_suffix(".csv"), "--output")
    results = Results(csv, ScoredDesign, study.origin)
    told = sys.stderr if args.json else sys.stdout
    if dropped := sweep.dropped():
        count = sum(dropped.values())
        print(f"left out: {count} designs whose corners lie beyond their sphere", file=told)
    if scored := study.swept(results):
        print(f"{csv}: {len(scored)} designs are there already", file=told)
    try:
        study.score_rest(results)
    except KeyboardInterrupt:
        if not study.swept(results):
            raise
    choice = Choice(study, study.swept(results))
    done, count = len(choice.rows), len(sweep.designs())
    style.save(draw(choice), picture)
    written = [csv, picture]
    if args.take is not None:
        with options.checking_options():
            numbers = Annotated[int, Quantity("", "", 1, len(choice.numbered))]
            design = choice.numbered[check(numbers, args.take, "--take") - 1].design
        written.append(csv.with_suffix(f".{args.take}.yaml"))
        taken = design_sweep.designed(scene, design, study.power, study.mount)
        taken = scene_from_settings(taken.settings(), written[-1].stem)
        about = f"{design.label}, by uuv_array study design from {scene.name}"
        save_scene(taken, written[-1], about)
    names = [*map(str, written)]
    result = {"complete": done == count, **choice.as_object(), "files": names}
    text = f"{report(choice)}\n{done} designs: {', '.join(names)}"
    missing = f"{done} of {count} designs; the same command resumes it"
    return outputs.finish(args, result, text, done == count, missing)
