"""``uuv_array study robustness``: measure estimates in a sea that differs from the scene.

Estimate poses from images of a sea that differs from the scene, by one kind of mismatch at a time:
another lamp, other water, daylight, broken detectors, shade, no lamp at all. The estimator assumes
the scene. It should answer images that its prior covers, with a consistent covariance, and refuse
the others; a pose that is off by more than six of its own standard deviations is false.
docs/reference/mismatches.md has the cures.

  uuv_array study robustness                               every kind, in the default scene
  uuv_array study robustness --method sam                  the paper's method
  uuv_array study robustness --kinds k-0.05,power_x0.8     some kinds
  uuv_array study robustness --scene night_plume --kinds nothing,moving
Ctrl-C ends it early and reports the kinds it has.
"""

import argparse
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.cli import options, outputs
from uuv_optical_array.core.geometry import Array, Z
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.core.storage.formats import cell, columns, plain
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.working_volume import lit_poses
from uuv_optical_array.plots.style import mark, new_figure, plain_log_ticks, save
from uuv_optical_array.studies.mismatches.kinds import Kind, kinds_named
from uuv_optical_array.studies.shared.errors import SIGMAS, FrameErrors, errors_of
from uuv_optical_array.studies.shared.results import until_interrupted

FAR_M = 1.0
# Logarithm of a likelihood ratio below which an image may be one of the scene itself: of its own
# images, one of a thousand at most is so much likelier by another light (Markov's inequality).
EXCUSED_BELOW = np.log(1000)
COLUMNS = {
    "kind": "kind",
    "times_prior": "times the prior",
    "answered": "answered",
    "beyond_6_sigma": "beyond 6 sigma",
    "indistinguishable": "indistinguishable",
    "beyond_1_m": "beyond 1 m",
    "rms_range_m": "range (m)",
    "rms_across_m": "across (m)",
    "rms_angle_deg": "angle (deg)",
    "nees_mean": "NEES",
    "beyond_3_sigma": "beyond 3 sigma",
}
# Key of a row, marker, colour and label of the errors.
ERRORS = (
    ("rms_range_m", "o", "#1f6fb4", "range (m)"),
    ("rms_across_m", "s", "#2c9c5a", "across (m)"),
    ("rms_angle_deg", "^", "#e08a00", "angle (deg)"),
)


def figures(kind: Kind, frames: FrameErrors, plausible: NDArray[np.bool_]) -> dict[str, Any]:
    """Return plain values of the frames of a kind; None for what is unknown.

    `plausible` says which images are about as likely by the scene as by the true light, ``(n,)``.
    """
    figures = {
        **{"kind": kind.name, "what": kind.what, "times_prior": kind.times_prior},
        "within_twice_prior": kind.within,
        "frames": len(frames.errors),
        "beyond_1_m": int((np.linalg.norm(frames.errors[:, : Z + 1], axis=1) > FAR_M).sum()),
        "beyond_3_sigma": int(frames.beyond_sigma(3.0).sum()),
        "indistinguishable": int((frames.beyond_sigma(SIGMAS) & plausible).sum()),
    }
    return plain(figures | frames.summary())


def log_ratio(
    model: ForwardModel, poses: Array, covariances: Array, images: Array, light: Array
) -> Array:
    """Return how much likelier images are by the true light than by answers, logarithms ``(n,)``.

    `light` ``(n, side, side)`` is that of the mismatch at the true pose. By the scene, readings
    vary by noise, and by the pose and constants that the answer's covariance and the prior leave
    open, linear about the answers `poses` ``(n, 5)``; inf where there is none.
    """
    posed, ratio = ~np.isnan(poses[:, 0]), np.full(len(poses), np.inf)
    if not posed.any():
        return ratio
    readings = images[posed].reshape(int(posed.sum()), -1)
    stds = model.scene.nuisance_std()
    offsets = {name: np.zeros(len(readings)) for name in stds}
    expected, jacobian = model.linearised(poses[posed], 0.0, offsets)
    low, high = model.noise.low, model.noise.high
    residual = readings - np.clip(expected, low, high)
    # Beyond a limit the light changes no reading.
    jacobian = np.where(((expected > low) & (expected < high))[..., None], jacobian, 0.0)
    joint = np.zeros((len(readings), 5 + len(stds), 5 + len(stds)))
    joint[:, :5, :5] = covariances[posed]
    joint[:, 5:, 5:] = np.diag(np.square(list(stds.values())))
    spread = jacobian @ joint @ np.swapaxes(jacobian, -1, -2)
    spread += np.eye(expected.shape[1]) * model.variance(expected)[0][:, None, :]
    distance = (residual * np.linalg.solve(spread, residual[..., None])[..., 0]).sum(axis=1)
    true = light[posed].reshape(readings.shape)
    squares = (readings - np.clip(true, low, high)) ** 2 / model.variance(true)[0]
    ratio[posed] = 0.5 * (distance - squares.sum(axis=1))
    return ratio


def measure(
    estimator: Estimator, kinds: Sequence[Kind], count: int, seed: int
) -> Iterator[dict[str, Any]]:
    """Yield the `figures` of `count` frames of each kind, which share poses and noise.

    Ctrl-C is raised after the last kind, of fewer frames.
    """
    model = ForwardModel(estimator.scene)
    for kind in kinds:
        poses = lit_poses(model, count, np.random.default_rng(seed), kind.draw)
        light = kind.light(model, poses, np.random.default_rng((seed, 1)))
        images = model.read(light, np.random.default_rng((seed, 2)))
        frames = errors_of(estimator, model, poses, images, kind.name)
        done = len(frames.errors)
        answered = poses[:done] + frames.errors
        ratio = log_ratio(model, answered, frames.covariances, images[:done], light[:done])
        yield figures(kind, frames, ratio < EXCUSED_BELOW)
        if done < count:
            raise KeyboardInterrupt


def report(rows: Sequence[dict[str, Any]]) -> str:
    """Return the kinds as a table."""
    return columns([[*COLUMNS.values()], *([cell(row[key]) for key in COLUMNS] for row in rows)])


def draw(rows: Sequence[dict[str, Any]], about: str) -> Any:
    """Draw the shares answered and false, and the errors, a row for each kind."""
    figure = new_figure(16, 2.4 + 0.24 * max(len(rows), 14))
    left, middle, right = grid = figure.subplots(1, 3, sharey=True, width_ratios=(1, 1, 1.5))
    y, texts = np.arange(len(rows)), ("kind", "what")
    of = {key: np.array([r[key] for r in rows], float) for key in rows[0] if key not in texts}
    posed = np.where(of["answered"] > 0, of["answered"], np.nan)
    excused = "of these indistinguishable from the scene"
    for axes, key, whole, colour, label in (
        (left, "answered", of["frames"], "#1f6fb4", "answered"),
        (middle, "beyond_6_sigma", posed, "#c8401e", "beyond 6 of its own sigma"),
        (middle, "indistinguishable", posed, "#e0a080", excused),
    ):
        bars = axes.barh(y, 100 * of[key] / whole, color=colour, label=label)
        if key != "indistinguishable":
            # An empty bar and a full one speak for themselves.
            shown = [f"{share:.3g}" if 0 < share < 100 else "" for share in bars.datavalues]
            axes.bar_label(bars, shown, padding=4, fontsize=8)
    left.set(xlim=(0, 115), xlabel="answered, of all (%)")
    middle.set(xlim=(0, 115), xlabel="beyond 6 sigma, of answered (%)")
    for key, marker, colour, label in ERRORS:
        right.plot(of[key], y, marker, color=colour, ms=6, alpha=0.85, label=label)
    right.axvline(FAR_M, color="k", lw=0.8, ls=":")
    right.set(xscale="log", xlabel="RMS error of the answered, m or deg")
    plain_log_ticks(right.xaxis)
    for axes in grid:
        for at in y[of["within_twice_prior"] > 0]:
            axes.axhspan(at - 0.5, at + 0.5, color="0.94", lw=0, zorder=0)
        axes.grid(axis="x", alpha=0.4)
        axes.set_axisbelow(True)
        axes.tick_params(axis="y", length=0)
    left.set_yticks(y, [row["what"].rstrip(".") for row in rows], fontsize=8)
    for at, row in zip(y, rows, strict=True):
        beside = {"xytext": (6, 0), "textcoords": "offset points", "va": "center", "fontsize": 8}
        right.annotate(row["kind"], (1, at), xycoords=right.get_yaxis_transform(), **beside)
    left.set_ylim(len(rows) - 0.5, -0.5)
    handles = [handle for axes in grid for handle in axes.get_legend_handles_labels()[0]]
    handles.append(mark("within twice the prior", "s", color="0.85", ms=9))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=10)
    figure.suptitle(f"Where the sea is not the scene: {about}", fontsize=13)
    return figure


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "follow")
    options.add_method(parser)
    about = "kinds of mismatch (default: all that the scene can have)"
    parser.add_argument("--kinds", metavar="NAME,...", help=about)
    poses = Quantity("random poses of each kind", "", 1, 1e7)
    options.add_number(parser, "poses", poses, 300)
    options.add_seed(parser)
    options.add_json(parser)
    outputs.add_picture(parser, "robustness.png")


def run(args: argparse.Namespace) -> int:
    """Run the study, print and draw it."""
    count, seed = args.poses, args.seed
    output = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    scene = options.scene_of(args)
    with options.checking_options():
        kinds = kinds_named(args.kinds, scene)
    estimator = Estimator(scene, args.method).wait()
    rows, complete = until_interrupted(measure(estimator, kinds, count, seed))
    about = f"{args.method} in scene {scene.name}, {count} poses a kind, seed {seed}"
    save(draw(rows, about), output)
    result = {"scene": scene.name, "method": args.method, "seed": seed, "poses": count}
    result |= {"complete": complete, "kinds": rows, "picture": str(output)}
    text = f"{about}\n\n{report(rows)}\n\npicture: {output}"
    return outputs.finish(args, result, text, complete, "the table ends where the work ended")
