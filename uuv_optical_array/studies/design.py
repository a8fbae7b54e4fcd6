"""``uuv_array study design``: sweep array and lamp, and say which design to build.

Sweep the array (shape, detectors, size, radius of curvature), the width of the lamp's beam and, in
a scene with `lamps`, their number, distance from the centre and tilt. Each design is scored by the
criteria of Eren et al. (2016), whether the signature tells 0.2 m and 10 deg apart 4 to 8 m behind
the lamp and how many detectors that takes, and by the Cramer-Rao bound over the working volume.
Pareto-optimal designs are printed. Scores go into a picture and a CSV, from which a sweep resumes.

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
import itertools
import math
import operator
import sys
import typing
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity, Setting, check, declared
from uuv_optical_array.core.storage.formats import columns
from uuv_optical_array.estimation.signature.spectral_angle import spectral_angle
from uuv_optical_array.forward import working_volume as volume
from uuv_optical_array.forward.array import ArraySettings, Shape
from uuv_optical_array.forward.beam import LampSettings, beam_solid_angle, gaussians_of
from uuv_optical_array.forward.lamps import ring_of_lamps, spread_and_tilt, together
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, save_scene, scene_from_settings
from uuv_optical_array.forward.working_volume import GUESSED, SPECIFICATION
from uuv_optical_array.plots import style
from uuv_optical_array.studies.shared.errors import blocks, bounds, position_and_angle
from uuv_optical_array.studies.shared.results import STEP, read, until_interrupted, write
from uuv_optical_array.studies.shared.separation import (
    THRESHOLD_DEG,
    WANTED,
    Conditions,
    angles_deg,
    from_paper_axes,
    paper_signature,
)

# Values of settings by their names, all of `SWEPT`.
Sweep: TypeAlias = Mapping[str, Sequence[Any]]

RING = declared(ring_of_lamps)
SWEPT: dict[str, Setting] = {
    name: (declared(ArraySettings) | declared(LampSettings))[name]
    for name in ("shape", "detectors_per_side", "width_m", "radius_m", "beam_sigma_deg")
} | RING
# Radii of 0.8 widths are as curved as the paper's.
DEFAULTS: dict[str, tuple[Any, ...]] = {
    "detectors_per_side": (3, 5, 7, 9, 11, 21),
    "width_m": (0.2, 0.3, 0.4, 0.5, 0.6),
    "radius_m": (0.16, 0.24, 0.32, 0.4, 0.48, 0.64),
    "beam_sigma_deg": (4.0, 6.0, 8.0, 11.0, 15.0, 20.0),
}
# What Eren et al. (2016) choose; their lamp is not given.
PAPER: dict[str, Any] = {"shape": "curved", "detectors_per_side": 5}
PAPER |= {"width_m": 0.4, "radius_m": 0.32}
SEED = 1
POSES = Quantity("poses for the bound", "", 1, 1e7)
TAKEN = Quantity("number of a design in the table to write as a scene, too", "", 1, 1e9)
NOISE_DRAWS = 64
ROUNDING_DEG = 1e-9  # angles below are rounding: the converter took all noise away
CLEAR_SIGMAS = 3.0


@dataclass(frozen=True)
class Design:
    """An array and lamps; settings as in `ArraySettings`, `LampSettings`, `ring_of_lamps`."""

    shape: Shape
    detectors_per_side: int
    width_m: float
    radius_m: float | None
    beam_sigma_deg: float
    lamps: int
    spread_m: float
    tilt_deg: float

    @classmethod
    def of(cls, scene: Scene) -> "Design":
        """Return the design that a scene has; of several lamps with the means of their ring."""
        ring = scene.lamp_count, *spread_and_tilt(scene.lamps)
        values: dict[str, Any] = {**vars(scene.array), **vars(scene.lamp)}
        values |= dict(zip(RING, ring, strict=True))
        return cls(**{name: values[name] for name in SWEPT})

    @property
    def detectors(self) -> int:
        """How many there are."""
        return self.detectors_per_side**2

    @property
    def label(self) -> str:
        """The design in words."""
        radius = "" if self.radius_m is None else f", radius {self.radius_m:g} m"
        side, beam = self.detectors_per_side, f"beam {self.beam_sigma_deg:g} deg"
        ring = f", {self.lamps} lamps at {self.spread_m:g} m, {self.tilt_deg:g} deg"
        lamps = ring if self.lamps > 1 else ""
        return f"{self.shape} {side} x {side}, {self.width_m:g} m{radius}, {beam}{lamps}"


def sweep_of(scene: Scene, words: Sequence[str] = ()) -> Sweep:
    """Return a sweep about a scene's own design, or of lists, each ``NAME=VALUE,VALUE``.

    ValueError for an unknown name, no value, one given twice or out of bounds, or no design left.
    """
    lists: dict[str, list[Any]] = {}
    for word in words:
        name, values = options.assigned(word, SWEPT)
        if name in lists:
            raise ValueError(f"{name}: given twice; give its values once")
        lists[name] = [options.value_of(name, SWEPT[name], value) for value in values.split(",")]
        for value, count in Counter(lists[name]).items():
            if count > 1:
                raise ValueError(f"{name}: {value} is given twice; give it once")
    own = vars(Design.of(scene))
    about = {name: sorted({*values, own[name] or values[0]}) for name, values in DEFAULTS.items()}
    about |= {"shape": [*typing.get_args(Shape)], **{name: [own[name]] for name in RING}}
    sweep = about | lists
    designs, dropped = designs_of(sweep)
    if not designs:
        raise ValueError(f"radius_m: no design is left ({'; '.join(dropped)}); give a larger one")
    return sweep


def designs_of(sweep: Sweep) -> tuple[list[Design], dict[str, int]]:
    """List the designs of a sweep that can be built, and count the others by their faults."""
    # The number of detectors changes fastest.
    names = ("shape", "radius_m", "width_m", "beam_sigma_deg", *RING, "detectors_per_side")
    faults = {}
    for values in itertools.product(*(sweep[name] for name in names)):
        design = Design(**dict(zip(names, values, strict=True)))
        if design.shape == "planar":
            design = dataclasses.replace(design, radius_m=None)
        if design.lamps == 1:  # in the middle
            design = dataclasses.replace(design, spread_m=0.0, tilt_deg=0.0)
        faults[design] = _fault(design)
    dropped = Counter(filter(None, faults.values()))
    return [design for design, fault in faults.items() if not fault], dict(dropped)


def _fault(design: Design) -> str:
    """Say why a design cannot be built, alike for all that share the reason; empty: it can be."""
    try:
        ArraySettings(design.shape, 2, design.width_m, 0.0, design.radius_m)
    except ValueError:
        return f"{design.width_m:g} m wide on a sphere of {design.radius_m:g} m: corners beyond it"
    if design.lamps > 1 and not (design.spread_m or design.tilt_deg):
        return "several lamps in one place that point the same way"
    return ""


def designed(scene: Scene, design: Design) -> Scene:
    """Return a scene with the array and the lamp of a design, whose lamp emits as much light.

    The array's foremost point stays. ValueError if it cannot be built, or gets no light.
    """
    bow_m = scene.array.bow_m - ((design.radius_m or 0.0) - (scene.array.radius_m or 0.0))
    side, radius_m = design.detectors_per_side, design.radius_m
    array = ArraySettings(design.shape, side, design.width_m, bow_m, radius_m)
    lamp = dataclasses.replace(scene.lamp, beam_sigma_deg=design.beam_sigma_deg)
    own, ring = Design.of(scene), {name: getattr(design, name) for name in RING}
    lamps = scene.lamps if ring.items() <= vars(own).items() else ring_of_lamps(**ring)
    if lamps and not scene.lamps:
        raise ValueError(
            f"lamps: {design.lamps}: scene {scene.name} has one and no prior of several; take one "
            "that extends leading_lights"
        )
    changed = dataclasses.replace(scene, array=array, lamp=lamp).with_lamps(lamps)
    if design == own:
        return changed
    own_sr, beam_sr = (
        beam_solid_angle(math.radians(it.beam_sigma_deg), gaussians_of(lamp))
        for it in (scene.lamp, design)
    )
    brighter = ForwardModel(scene).power * own_sr / beam_sr / ForwardModel(changed).power
    lamp = dataclasses.replace(lamp, reference_counts=brighter * lamp.reference_counts)
    return dataclasses.replace(changed, lamp=lamp)


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
    """What a sweep offers: the Pareto-optimal designs among the scored ones about a scene's."""

    scene: Scene
    rows: Sequence[ScoredDesign]

    @functools.cached_property
    def fronts(self) -> dict[str, list[ScoredDesign]]:
        """Fronts of what is no wider than the scene's array, of what resolves, and of all."""
        fits = [row for row in self.rows if row.width_m <= self.scene.array.width_m]
        resolved = [row for row in fits if row.resolved_at_4m]
        return {"fits": front(fits), "resolved": front(resolved), "any": front(self.rows)}

    @functools.cached_property
    def papers(self) -> list[ScoredDesign]:
        """The paper's array with the scene's lamps, where it is swept."""
        own = dataclasses.replace(Design.of(self.scene), **PAPER)
        return [row for row in self.rows if row.design == own]

    @functools.cached_property
    def numbered(self) -> list[ScoredDesign]:
        """Every design that is listed, once: the fronts in turn, then the paper's array."""
        on_fronts = [row for rows in self.fronts.values() for row in rows]
        return list(dict.fromkeys([*on_fronts, *self.papers]))

    def table(self) -> str:
        """Return `numbered` as a table."""
        heads = ("position", "angle", "lit", "at 4 m", "", "4 to 8 m", "", "")
        lines: list[tuple[object, ...]] = [
            ("no", "design", "front", "15 deg", *heads),
            ("", "", "", "at", "m", "deg", "%", "0.2 m", "10 deg", "0.2 m", "10 deg", "sigma"),
        ]
        for number, row in enumerate(self.numbered, start=1):
            on_fronts = [name for name, rows in self.fronts.items() if row in rows] or ["none"]
            standing = ", ".join(on_fronts) + "; the paper's array" * row.is_papers_array
            bounds = f"{row.position_m:.3f}", f"{row.angle_deg:.2f}", f"{100 * row.lit:.0f}"
            angles = row.shift_near_deg, row.yaw_near_deg, row.shift_deg, row.yaw_deg, row.sigmas
            told = (f"{angle:.1f}" for angle in angles)
            lines.append((number, row.label, standing, row.resolved, *bounds, *told))
        return columns(lines, 4)

    def as_object(self) -> dict[str, Any]:
        """Return plain values; None is not known, or has no bound."""
        place = {row: i for i, row in enumerate(self.rows)}
        return {
            "designs": [row.columns() for row in self.rows],
            "fronts": {name: [place[row] for row in rows] for name, rows in self.fronts.items()},
            "numbered": [place[row] for row in self.numbered],
            "papers_array": [i for i, row in enumerate(self.rows) if row.is_papers_array],
        }


def report(choice: Choice) -> str:
    """Return the designs that are listed, and how many meet the criterion."""
    far = [row for row in choice.rows if row.resolved_4_to_8m]
    near = sum(row.resolved_at_4m for row in choice.rows)
    clear = sum(row.sigmas >= CLEAR_SIGMAS for row in far)
    return (
        f"{choice.table()}\n\n"
        f"{near} of {len(choice.rows)} designs tell 0.2 m and 10 deg apart by 15 deg at 4 m, "
        f"{len(far)} from 4 to 8 m;\nof these, {clear} by {CLEAR_SIGMAS:g} or more standard "
        "deviations of their signature's noise"
    )


# Score, axis label, the specification, and what is known without light.
BOUNDS = {
    "position_m": ("bound on position, RMS (m)", float(SPECIFICATION[0]), GUESSED[0]),
    "angle_deg": ("bound on angle, RMS (deg)", float(SPECIFICATION[3]), GUESSED[1]),
}
BESIDE: dict[Shape, float] = {"planar": -0.2, "curved": 0.0}  # where a shape is drawn


def draw(choice: Choice, about: str) -> Any:
    """Draw bounds against detectors, numbered as in `Choice.table`, and the paper's criterion."""
    rows, width_m = choice.rows, choice.scene.array.width_m
    figure = style.new_figure(16, 7)
    *by_detectors, criterion = figure.subplots(1, 3)
    for axes, name in zip(by_detectors, BOUNDS, strict=True):
        _all_designs(axes, choice, name)
    _dots(criterion, [min(row.shift_deg, row.yaw_deg) for row in rows], rows, "angle_deg")
    criterion.axvline(THRESHOLD_DEG, color="k", lw=1)
    criterion.set_xlabel("spectral angle of 0.2 m or 10 deg, the lesser, 4 to 8 m (deg)")
    criterion.set_title(f"right of {THRESHOLD_DEG:g} deg the paper's criterion is met", fontsize=11)
    handles, labels = by_detectors[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=11, frameon=False)
    title = f"What to build: {len(rows)} designs of array and lamp, scene {choice.scene.name}"
    figure.suptitle(f"{title}, whose array is {width_m:g} m wide\n{about}", fontsize=13)
    return figure


def _dots(axes: Any, x: Sequence[float], rows: Sequence[ScoredDesign], name: str) -> None:
    """Draw a bound of designs as dots, coloured by their shape, and what it compares with."""
    for shape, colour in style.SHAPE_COLOURS.items():
        points = [(at, getattr(r, name)) for at, r in zip(x, rows, strict=True) if r.shape == shape]
        axes.plot(*np.reshape(points, (-1, 2)).T, "o", color=colour, ms=3, alpha=0.5, label=shape)
    label, wanted, free = BOUNDS[name]
    paper = {"color": style.SPECIFIED, "label": "specification of the paper"}
    axes.axhline(wanted, ls="--", lw=1.4, zorder=1, **paper)
    axes.axhline(free, color="0.5", ls=":", lw=1.4, zorder=1, label="no measurement at all")
    axes.set(yscale="log", ylabel=label)
    style.plain_log_ticks(axes.yaxis)
    axes.grid(alpha=0.3, lw=0.5)


def _all_designs(axes: Any, choice: Choice, name: str) -> None:
    """Draw every design by its number of detectors, the fronts, and numbers of what fits."""
    rows, bound = choice.rows, operator.attrgetter(name)
    sides = sorted({row.detectors_per_side for row in rows})

    def place(row: ScoredDesign) -> float:
        return sides.index(row.detectors_per_side) + BESIDE[row.shape]

    _dots(axes, [place(row) for row in rows], rows, name)
    axes.set_xticks(range(len(sides)), [f"{n} x {n}" for n in sides])
    axes.set(xlim=(-0.5, len(sides) - 0.5), xlabel="detectors")
    for front_name, dashes, label in (
        ("fits", "-", "front 'fits': no wider than the scene's"),
        ("any", "--", "front 'any': of any width"),
    ):
        # Of each number of detectors the best; the last of a key stays.
        on_front = sorted(choice.fronts[front_name], key=bound, reverse=True)
        best = {row.detectors_per_side: row for row in on_front}
        line = [best[side] for side in sorted(best)]
        axes.plot([*map(place, line)], [*map(bound, line)], "ko", ls=dashes, lw=1.2, label=label)
    own, ring = choice.papers, {"marker": "o", "ms": 7, "mfc": "none", "mec": "k", "ls": ""}
    about = "the paper's array with the scene's lamp"
    axes.plot([*map(place, own)], [*map(bound, own)], label=about, **ring)
    named = [*choice.fronts["fits"], *own]
    points = {n: (place(r), bound(r)) for n, r in enumerate(choice.numbered, 1) if r in named}
    style.number_points(axes, points)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "follow")
    about = f"values of {', '.join(SWEPT)} (default: a grid about the scene's own)"
    parser.add_argument("--sweep", nargs="+", default=[], metavar="NAME=VALUE,...", help=about)
    options.add_number(parser, "poses", POSES, 1000)
    about = "picture, with the CSV of every design beside it (default: SCENE.design.png here)"
    outputs.add_picture(parser, None, about=about)
    options.add_number(parser, "take", TAKEN, None, int)
    options.add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Score what is not scored yet, and print, write and draw it."""
    scene = options.scene_of(args)
    with options.checking_options():
        sweep = sweep_of(scene, args.sweep)
    picture = args.output or f"{scene.name}.design.png"
    picture = outputs.file_to_write(picture, "--output", outputs.PICTURE)
    csv = outputs.file_to_write(picture.with_suffix(".csv"), "--output")
    told, about = sys.stderr if args.json else sys.stdout, origin(scene, args.poses)
    there = {row.design: row for row in scored_before(csv, about)}
    designs, dropped = designs_of(sweep)
    if count := sum(dropped.values()):
        print(f"left out: {count} designs whose corners lie beyond their sphere", file=told)
    if known := [there[design] for design in designs if design in there]:
        print(f"{csv}: {len(known)} designs are there already", file=told)
    left = progress.over([design for design in designs if design not in there], "design")

    def kept() -> Iterator[ScoredDesign]:
        for row in scored(scene, left, args.poses):
            there[row.design] = row
            write(csv, about, [one.columns() for one in there.values()])
            yield row

    rows, complete = until_interrupted(itertools.chain(known, kept()))
    choice = Choice(scene, sorted(rows, key=lambda row: designs.index(row.design)))
    style.save(draw(choice, f"lamps of equal flux; {args.poses} poses, seed {SEED}"), picture)
    written = [csv, picture]
    if args.take is not None:
        with options.checking_options():
            numbers = Annotated[int, Quantity("", "", 1, len(choice.numbered))]
            design = choice.numbered[check(numbers, args.take, "--take") - 1].design
        written.append(csv.with_suffix(f".{args.take}.yaml"))
        taken = scene_from_settings(designed(scene, design).settings(), written[-1].stem)
        comment = f"{design.label}, by uuv_array study design from {scene.name}"
        save_scene(taken, written[-1], comment)
    names = [*map(str, written)]
    result = {"complete": complete, **about, "sweep": sweep, **choice.as_object()}
    result |= {"dropped": dropped, "files": names}
    text = f"{report(choice)}\n{len(rows)} designs: {', '.join(names)}"
    missing = f"{len(rows)} of {len(designs)} designs; the same command resumes it"
    return outputs.finish(args, result, text, complete, missing)
