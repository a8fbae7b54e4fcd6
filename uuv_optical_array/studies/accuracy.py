"""``uuv_array study accuracy``: measure errors beside bound and covariances.

Estimate random poses of a scene, 4 to 8 m behind the lamp, +-0.9 m and +-20 deg, whose image peaks
above 20 counts, and compare the errors with the Cramer-Rao bound of one image and with the
covariances of the estimates. --known draws seas from each of the priors exactly, calibrated and
as_bought, and prints how much the bound falls if one more setting is known. --lamps places and
tilts one to four lamps as the scene's are, in a known sea, in one drawn from the prior, and in the
drawn one behind a cloud, which shades every image unevenly by 20 %; the estimator then expects half
of the images to be shaded. docs/results/accuracy.md explains every figure.

  uuv_array study accuracy                           20,000 poses of the reference scene
  uuv_array study accuracy --scene follow --json     the default scene, as one JSON object
  uuv_array study accuracy --method sam              the paper's method
  uuv_array study accuracy --shape planar            the same scene with a planar array
  uuv_array study accuracy --scene follow --known    errors when less of the sea is known
  uuv_array study accuracy --scene leading_lights --lamps  what several lamps gain
  uuv_array study accuracy --scene harbour --drawn   each image in a sea drawn from the prior
  uuv_array study accuracy --scene night_plume --moving   with clouds, flicker and drift
Ctrl-C ends the study early and reports the frames it has.
"""

import argparse
import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.random import Generator
from scipy.special import chdtri

from uuv_optical_array.cli import options, outputs
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, IN_DEGREES, Array
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.core.storage.formats import columns
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.aim import aim_count, apparent
from uuv_optical_array.forward.effects import MOVING
from uuv_optical_array.forward.lamp.lamps import ring_of_lamps, spread_and_tilt
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import ROLL, UNEVEN_DEPTH, FrameLight, Known, PriorSettings
from uuv_optical_array.forward.scene import Scene, scene_from_settings
from uuv_optical_array.forward.working_volume import DAY_S, lit_poses
from uuv_optical_array.plots.style import mark, new_figure, save
from uuv_optical_array.studies.shared.errors import (
    SIGMAS,
    FrameErrors,
    bounds,
    by_column,
    errors_of,
    range_across_angle,
)
from uuv_optical_array.studies.shared.results import until_interrupted

POSES, KNOWN_POSES = 20_000, 4_000
BAND = 0.95
COLOURS = "#3b5b8c", "#4fb37a", "#f6cf7a"  # from dark to light, so that they differ in grey, too
BAR = 0.26
NUMBERS = 1, 2, 3, 4  # of lamps
SEAS = {
    "known": "known sea",
    "drawn": "sea drawn from the prior",
    "cloud": f"the same behind a cloud, an uneven shade of {UNEVEN_DEPTH:.0%}",
}
RMS = "rms_error", "rms_bound"
CLOUD, EXPECTED = FrameLight(1.0, UNEVEN_DEPTH), 0.5  # and the share that the estimator expects


def measure(
    estimator: Estimator, poses: Array, images: Array, truth: Scene | None = None
) -> dict[str, Any]:
    """Return the `figures` of images at true poses ``(n, 5)``, m and rad, by a believed scene.

    The bound is that of the scene `truth`; ``None``: the believed one. Ctrl-C ends it with the
    frames it has; ValueError where none got a pose.
    """
    model = ForwardModel(truth or estimator.scene)
    (_, stds), frames = bounds(model, poses), errors_of(estimator, model, poses, images)
    count = len(frames.errors)
    if not frames.posed.any():
        raise ValueError(f"scene {estimator.scene.name}: none of {count} frames got a pose")
    return figures(frames, stds[:count])


def figures(frames: FrameErrors, bounds: Array) -> dict[str, Any]:
    """Return plain values, errors in m and deg, times in ms.

    `bounds` are Cramer-Rao standard deviations at the true poses, m and rad, ``(n, 5)``. Means are
    over frames with a pose; that of chi-square(5) is in ``nees_band`` with probability `BAND`.
    """
    nees = frames.nees
    rms_bound = np.sqrt(np.mean(bounds[frames.posed] ** 2, axis=0))
    band = chdtri(5 * len(nees), np.array([1 + BAND, 1 - BAND]) / 2) / len(nees)
    median_ms, slow_ms = frames.frame_ms
    return {
        "poses": len(frames.errors),
        "rms_error": by_column(frames.rms_error * IN_DEGREES),
        "rms_bound": by_column(rms_bound * IN_DEGREES),
        "ratio_to_bound": _by_dof(frames.rms_error / rms_bound),
        "beyond_6_sigma": int(frames.beyond_sigma(SIGMAS).sum()),
        "beyond_6_bounds": int((np.abs(frames.errors) > SIGMAS * bounds).any(axis=1).sum()),
        "nees_mean": float(nees.mean()),
        "nees_std_error": float(nees.std() / np.sqrt(len(nees))),
        "nees_band": band.tolist(),
        "without_pose": int((~frames.posed).sum()),
        "frame_ms": {"median": median_ms, "99th_percentile": slow_ms},
        "model_ms": frames.model_ms,
    }


def _by_dof(values: Array) -> dict[str, float]:
    return dict(zip(DOF_NAMES, values.tolist(), strict=True))


def exposed(
    model: ForwardModel, poses: Array, seed: int, drawn: bool, moving: bool, rng: Generator
) -> Array:
    """Return images at poses ``(n, 5)``, m and rad, of a truth that the estimator does not know.

    Where `drawn`, what the scene's prior leaves uncertain is drawn from it for each image; where
    `moving`, each image is of a random time of a day. `rng` is of the noise alone.
    """
    truth = np.random.default_rng((seed, 1))
    times_s = truth.uniform(0, DAY_S, len(poses)) if moving else None
    stds = model.scene.nuisance_std() if drawn else {}
    offsets = {name: std * truth.standard_normal(len(poses)) for name, std in stds.items()}
    roll = offsets.pop(ROLL, 0.0)
    if drawn:
        aims = truth.standard_normal((len(poses), aim_count(model.scene)))
        poses = apparent(model.scene, poses, aims)
    light, side = model.light(poses, roll, offsets, times_s), model.array.side
    if drawn:
        gains = 1 + model.scene.prior.gain_std * truth.standard_normal((len(poses), side, side))
        light = model.with_gains(light, gains)
    return model.read(light, rng)


def compare(
    cases: Iterable[tuple[dict[str, Any], Scene, Scene]], poses: Array, seed: int
) -> Iterator[dict[str, Any]]:
    """Yield the `figures` of each case in a sea that is drawn from its prior, with its name.

    A case is its name, the true scene and the believed one. Poses, ``(n, 5)`` in m and rad, and
    noise are the same in every sea. Ctrl-C is raised after the last one, of fewer frames.
    """
    for name, truth, believed in cases:
        noise = np.random.default_rng((seed, 2))
        images = exposed(ForwardModel(truth), poses, seed, True, False, noise)
        result = measure(Estimator(believed, "least_squares").wait(), poses, images, truth)
        yield {**name, **result}
        if result["poses"] < len(poses):
            raise KeyboardInterrupt


def by_known(scene: Scene) -> Iterator[tuple[dict[str, Any], Scene, Scene]]:
    """Yield a scene with each of `PRIORS`, as cases of `compare`."""
    for known in get_args(Known):
        believed = scene_from_settings({**scene.settings(), "prior": {"known": known}}, scene.name)
        yield {"known": known}, believed, believed


class Clouded(Scene):
    """A scene of whose images each is shaded unevenly, as by the light `CLOUD`."""

    def nuisance_std(self) -> dict[str, float]:
        """Return the standard deviations of the shade, too."""
        return {**super().nuisance_std(), **self.prior.std_in(CLOUD)}


def by_lamps(scene: Scene) -> Iterator[tuple[dict[str, Any], Scene, Scene]]:
    """Yield a scene with each of `NUMBERS` of lamps in each of `SEAS`, as cases of `compare`."""
    spread_m, tilt_deg = spread_and_tilt(scene.lamps)
    for lamps in NUMBERS:
        drawn = scene.with_lamps(ring_of_lamps(lamps=lamps, spread_m=spread_m, tilt_deg=tilt_deg))
        known = dataclasses.replace(drawn, prior=PriorSettings())
        shaded = dataclasses.replace(drawn.prior, gain_std=drawn.prior.gain_std_in(CLOUD))
        cloud = Clouded(**{**vars(drawn), "prior": shaded})
        expected = dataclasses.replace(drawn.prior, uneven_probability=EXPECTED)
        wary = dataclasses.replace(drawn, prior=expected)
        pairs = (known, known), (drawn, drawn), (cloud, wary)
        for sea, (truth, believed) in zip(SEAS, pairs, strict=True):
            yield {"lamps": lamps, "sea": sea}, truth, believed


def costs(scene: Scene, poses: Array) -> dict[str, dict[str, float]]:
    """Return the RMS bound at poses, m and deg, and where one more key of the prior is known."""

    def bound(**known: Any) -> dict[str, float]:
        prior = dataclasses.replace(scene.prior, **known)
        _, stds = bounds(ForwardModel(dataclasses.replace(scene, prior=prior)), poses)
        return _by_dof(np.sqrt(np.mean(stds**2, axis=0)) * IN_DEGREES)

    uncertain = [key for key, value in vars(scene.prior).items() if "std" in key and value > 0]
    return {"as it is": bound(), **{key: bound(**{key: 0.0}) for key in uncertain}}


def _fixed(values: dict[str, float]) -> list[str]:
    return [f"{value:.4f}" for value in values.values()]


def report(result: dict[str, Any]) -> str:
    """Return the values of `figures` as text."""
    cells = zip(
        *(DOF_NAMES, DOF_UNITS, _fixed(result["rms_error"]), _fixed(result["rms_bound"])),
        (f"{ratio:.3f}" for ratio in result["ratio_to_bound"].values()),
        strict=True,
    )
    table = columns([("", "", "RMS error", "RMS bound", "ratio"), *cells], 2)
    of, (low, high) = f"of {result['poses']}", result["nees_band"]
    median_ms, slow_ms = result["frame_ms"].values()
    model_ms = result["model_ms"]
    return f"""\
{table}

without a pose: {result["without_pose"]} {of}
off by more than 6 of its own standard deviations: {result["beyond_6_sigma"]} {of}
off by more than 6 of the bound at the truth: {result["beyond_6_bounds"]} {of}
mean NEES: {result["nees_mean"]:.3f} +- {result["nees_std_error"]:.3f}, 95 % band of chi-square(5) \
{low:.3f} to {high:.3f}
one frame: median {median_ms:.2f} ms ({median_ms / model_ms:.1f} of {model_ms:.2f} ms for the \
model of 4 poses), 99th percentile {slow_ms:.2f} ms"""


def comparison(rows: Sequence[dict[str, Any]]) -> str:
    """Return rows of `compare` as text."""
    names = [name for name in ("known", "lamps", "sea") if name in rows[0]]
    heads = ("range", "m", "across", "m", "angle", "deg")
    lines: list[Sequence[Any]] = [
        (*names, *heads, "NEES", "beyond", "no pose", "time"),
        (*len(names) * [""], *(3 * ("error", "bound")), "", "6 sigma", "", "ms"),
    ]
    for row in rows:
        both = zip(*(range_across_angle(row[key].values()) for key in RMS), strict=True)
        errors = [f"{value:.3f}" for pair in both for value in pair]
        honesty = f"{row['nees_mean']:.2f}", row["beyond_6_sigma"], row["without_pose"]
        median = f"{row['frame_ms']['median']:.2f}"
        lines.append((*(row[name] for name in names), *errors, *honesty, median))
    return columns(lines, 2)


def draw(rows: Sequence[dict[str, Any]], title: str, along: str) -> Any:
    """Draw the errors of `compare`, against what a case is called `along`, as bars for each sea."""
    names, seas = (list(dict.fromkeys(row.get(key) for row in rows)) for key in (along, "sea"))
    figure = new_figure(14, 4.6)
    titles = "range (m)", "across, an axis (m)", "angle, pitch or yaw (deg)"
    for i, axes in enumerate(figure.subplots(1, 3)):
        for row in rows:
            sea = seas.index(row.get("sea"))
            at = names.index(row[along]) + BAR * (sea - (len(seas) - 1) / 2)
            error, bound = (range_across_angle(row[key].values())[i] for key in RMS)
            axes.bar(at, error, 0.9 * BAR, color=COLOURS[sea])
            axes.hlines(bound, at - 0.5 * BAR, at + 0.5 * BAR, color="k", lw=1.6)
            words = {"textcoords": "offset points", "ha": "center", "fontsize": 8}
            axes.annotate(f"{error:#.2g}".lstrip("0"), (at, max(error, bound)), (0, 5), **words)
        axes.set_xticks(range(len(names)), names)
        axes.set(title=titles[i], xlabel=along)
        axes.margins(y=0.12)
    figure.axes[0].set_ylabel("RMS error of one image")
    shown = [(SEAS[sea], COLOURS[i]) for i, sea in enumerate(seas) if sea]
    handles = [mark(label, "s", color=colour, ms=9) for label, colour in shown]
    handles.append(mark("Cramer-Rao bound", "_", color="k", ms=12))
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    figure.suptitle(title)
    return figure


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "reference")
    options.add_shape(parser)
    options.add_method(parser)
    poses = Quantity(f"random poses; {KNOWN_POSES} with --known or --lamps", "", 1, 1e7)
    options.add_number(parser, "poses", poses, POSES)
    parser.set_defaults(poses=None)
    options.add_seed(parser)
    for name, what in (
        ("known", "the priors exactly, calibrated and as_bought"),
        ("lamps", "one to four lamps of the scene's total power"),
    ):
        about = f"compare {what}, and draw the errors into FILE (default: %(const)s)"
        words: dict[str, Any] = {"type": Path, "nargs": "?", "const": Path(f"{name}.png")}
        parser.add_argument(f"--{name}", metavar="FILE", help=about, **words)
    drawn = "draw each image's sea from the scene's prior"
    parser.add_argument("--drawn", action="store_true", help=drawn)
    moving = "take images at random times, for flicker, drift and clouds"
    parser.add_argument("--moving", action="store_true", help=moving)
    options.add_json(parser)


def _check_truth(args: argparse.Namespace, scene: Scene) -> None:
    """Raise ValueError where options exclude each other, or the scene lacks what they need."""
    if args.known or args.lamps:
        names = "known", "lamps", "moving", "drawn"
        first, *others = [f"--{name}" for name in names if vars(args)[name]]
        if args.method != "least_squares":
            raise ValueError(f"{first}: {args.method} estimates no constants; use least_squares")
        if others:
            raise ValueError(f"{first}: takes no {others[0]}; leave one of them out")
    where = f"scene {scene.name}"
    if args.lamps and not scene.lamps:
        raise ValueError(f"--lamps: {where} has no lamps; name one such as leading_lights")
    if args.moving and not MOVING & set(scene.effects):
        moving = ", ".join(sorted(MOVING))
        raise ValueError(f"--moving: nothing moves in {where}; add one of {moving}")
    if args.drawn and not scene.nuisance_std():
        raise ValueError(f"--drawn: {where} has no prior to draw from; give it one")


def run(args: argparse.Namespace) -> int:
    """Run the study and print it."""
    compared = "known" if args.known else "lamps" if args.lamps else ""
    if args.poses is None:
        args.poses = KNOWN_POSES if compared else POSES
    count, seed = args.poses, args.seed
    scene = options.scene_of(args)
    scene = scene.with_shape(args.shape or scene.array.shape)
    with options.checking_options():
        _check_truth(args, scene)
    if compared:
        picture = outputs.file_to_write(vars(args)[compared], f"--{compared}", outputs.PICTURE)
    rng, model = np.random.default_rng(seed), ForwardModel(scene)
    poses = lit_poses(model, count, rng)
    result: dict[str, Any]
    if compared:
        if args.known:
            cases, by = by_known(scene), "how well the sea is known"
        else:
            cases, by = by_lamps(scene), "number of lamps of the same total power"
        rows, complete = until_interrupted(compare(cases, poses, seed))
        result = {"poses": count, compared: rows, "picture": str(picture)}
        text = comparison(rows)
        if args.known:
            result["costs"] = costs(scene, poses)
            table = [(key, *_fixed(bound)) for key, bound in result["costs"].items()]
            heads = ("bound, with this known", *DOF_NAMES), ("", *DOF_UNITS)
            text += f"\n\n{columns([*heads, *table])}"
        save(draw(rows, f"Errors by {by}: scene {scene.name}, {count} poses", compared), picture)
        text += f"\n\npicture: {picture}"
    else:
        estimator = Estimator(scene, args.method).wait()
        images = exposed(model, poses, seed, args.drawn, args.moving, rng)
        result = measure(estimator, poses, images)
        text, complete = report(result), result["poses"] == count
    about: dict[str, Any] = {"scene": scene.name, "shape": scene.array.shape}
    about |= {key: getattr(args, key) for key in ("method", "seed", "drawn", "moving")}
    drawn = ", nuisances drawn" * args.drawn + ", at random times" * args.moving
    head = (
        f"{args.method} in scene {scene.name}, {scene.array.shape} array, "
        f"{result['poses']} random poses, seed {seed}{drawn}"
    )
    text = f"{head}\n\n{text}"
    return outputs.finish(args, about | result, text, complete, "only complete frames count")
