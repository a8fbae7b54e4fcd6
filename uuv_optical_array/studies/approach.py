"""``uuv_array study approach``: repeat the Monte Carlo of Eren et al. (2017), and by our method.

Repeat the Monte Carlo of Eren et al. (Sensors 2017): a follower closes from 8.5 m to 4.5 m behind a
lamp at 0.5 m/s and takes 41 images, in a dive and in a zigzag, in tank water and in murkier water.
In every run temperature and attenuation are off by unknown constants. The published errors stand
beside those of the published method rebuilt (moments), single images (least_squares), their track
(tracker) and a smoother for constant lamp and water (docking); see docs/results/approach.md.

  uuv_array study approach                      100 runs of each case
  uuv_array study approach --runs 2000          as many as the paper
  uuv_array study approach --output errors.svg  the picture where you want it
Ctrl-C ends it early and reports the complete runs.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, IN_DEGREES, Array, rotation_matrix
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.core.storage.formats import columns, plain
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.signature.features import scene_parameters
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, scene_from_settings
from uuv_optical_array.plots.style import METHOD_COLOURS, new_figure, save
from uuv_optical_array.studies.docking_smoother import Motion, bound, smoothed
from uuv_optical_array.studies.shared.errors import by_column
from uuv_optical_array.studies.shared.published import calibrate, dead_reckoned
from uuv_optical_array.studies.shared.results import until_interrupted

FAR_M, NEAR_M, SPEED_M_PER_S, RATE_HZ = 8.5, 4.5, 0.5, 5.0
STEP_S = 1 / RATE_HZ
FRAMES = round((FAR_M - NEAR_M) / SPEED_M_PER_S * RATE_HZ) + 1
TIMES_S = STEP_S * np.arange(FRAMES)
RANGES_M = FAR_M - SPEED_M_PER_S * TIMES_S
TURN_RATE_DEG_PER_S = 10.0
NOISE_COUNTS = 0.01 * 1023.0  # 1 % of full scale: uniform from 0 on
GAIN_PER_C = -2 / 576  # 2 mV of 576 mV for each degree by which the water's temperature is off
TEMPERATURE_C, K_PER_M = 3.0, 0.015

BATCH = 20
METHODS = ("moments", "least_squares", "tracker", "docking")
PUBLISHED = "mean_end", "start_95", "end_95"  # errors, as of a `Case`
PRINTED = {"mean_end": "mean error at the end", "end_95": "95 % of errors at the end"}
SEED = 1
SIGMA_95 = 1.96
AIM = np.array([5, 5, 5, 1, 1])  # so many times smaller than the published errors at the end


class Case(NamedTuple):
    """A case of the paper, whose errors are in m and deg, nan where it gives none."""

    k_per_m: float  # attenuation that the estimators assume
    path: Array  # true poses, (FRAMES, 5)
    mean_end: Array  # the mean error at the end
    start_95: Array  # 95 % of the errors at the start
    end_95: Array  # and at the end


def _path(start: tuple[float, float], pitch_deg: Array, yaw_deg: Array) -> Array:
    """Follow the heading from y, z = `start`, with a constant speed towards the lamp."""
    pitch, yaw = np.radians([pitch_deg, yaw_deg])
    heading = rotation_matrix(pitch, yaw)[..., 0]
    slope = heading[:, 1:] / heading[:, :1]
    steps = SPEED_M_PER_S * STEP_S * (slope[1:] + slope[:-1]) / 2
    across = start + np.pad(np.cumsum(steps, axis=0), ((1, 0), (0, 0)))
    return np.column_stack([-RANGES_M, across, pitch, yaw])


# The paper has y to starboard and z down, and does not say when a zigzag turns: here half-way.
_YAW = np.clip((TIMES_S - TIMES_S[-1] / 2) * TURN_RATE_DEG_PER_S, -10.0, 10.0)
_DIVE = _path((0.0, 0.0), np.full(FRAMES, 10.0), np.zeros(FRAMES))
_ZIGZAG = _path((-0.2, 0.1), np.zeros(FRAMES), _YAW)
_IN_DIVE = [0.02, 0.02, 0.18, 5, 1], [0.83, 0.18, 0.22, 2, np.nan], [0.43, 0.20, 0.28, 1, 1]
_IN_ZIGZAG = [0.13, 0.13, 0.05, 3, 4], [0.83, 0.18, 0.20, 2, 3], [0.46, 0.30, 0.28, 1, 1]
_IN_MURK = [0.26, 0.17, 0.01, 3, 4], [np.nan] * 5, [0.36, 0.80, 0.86, 8, 9]
CASES = {
    "dive": Case(0.09, _DIVE, *np.array(_IN_DIVE)),
    "zigzag": Case(0.09, _ZIGZAG, *np.array(_IN_ZIGZAG)),
    "zigzag, murky": Case(0.2, _ZIGZAG, *np.array(_IN_MURK)),
}


def assumed_scene(scene: Scene, case: Case) -> Scene:
    """Return the scene that the estimators assume, with the uncertainty of its settings.

    The lamp of the tank stays the same, whatever the water. The mean of unipolar noise is an
    ambient level, its spread a Gaussian one. ValueError for a scene without attenuation.
    """
    if "attenuation" not in scene.effects:
        raise ValueError(f"scene {scene.name}: no effects.attenuation; add it")
    settings = scene.settings()
    settings["effects"]["ambient"] = {"level_counts": 0.0}
    # The reading that the same lamp gives in the water of the case.
    lamp = settings["lamp"]
    aligned = np.array([-lamp["reference_range_m"], 0.0, 0.0, 0.0, 0.0])
    off = {"attenuation.k_per_m": np.array(case.k_per_m - scene.effects["attenuation"]["k_per_m"])}
    dark = ForwardModel(scene_from_settings(settings, scene.name))
    lamp["reference_counts"] = float(dark.light(aligned, 0.0, off).max())
    settings["effects"]["attenuation"]["k_per_m"] = case.k_per_m
    settings["effects"]["ambient"]["level_counts"] = NOISE_COUNTS / 2
    settings["effects"]["sensor_noise"] = {"sigma_counts": NOISE_COUNTS / 12**0.5}
    settings["prior"] = {"lamp_power_std": TEMPERATURE_C * abs(GAIN_PER_C), "k_std_per_m": K_PER_M}
    return scene_from_settings(settings, scene.name)


def draw_offsets(runs: int, rng: Generator) -> dict[str, Array]:
    """Draw the offsets of each run: of the logarithm of the gain, and of the attenuation, 1/m."""
    degrees = rng.normal(0.0, TEMPERATURE_C, runs)
    k_per_m = rng.normal(0.0, K_PER_M, runs)
    return {"lamp.power": np.log1p(GAIN_PER_C * degrees), "attenuation.k_per_m": k_per_m}


def expose(model: ForwardModel, path: Array, offsets: dict[str, Array], rng: Generator) -> Array:
    """Expose all images of n runs with `draw_offsets`, counts, ``(n, frames, side, side)``."""
    shape = (len(offsets["lamp.power"]), len(path))
    spread = {name: np.broadcast_to(off[:, None], shape) for name, off in offsets.items()}
    light = model.light(np.broadcast_to(path, (*shape, 5)), 0.0, spread)
    # The mean of the noise is in the light, as an ambient level.
    return model.converted(light + NOISE_COUNTS * (rng.random(light.shape) - 0.5))


class ApproachErrors(NamedTuple):
    """The errors in n runs of a case, m and rad."""

    errors: Mapping[str, Array]  # estimate less truth by method, (n, FRAMES, 5), nan without a pose
    bound: Array  # of a single frame, by Cramer and Rao, with the prior, (FRAMES, 5)
    run_bound: Array  # of all frames so far, with the motion of the smoother


def percentile_95(errors: Array) -> Array:
    """95 % of absolute errors ``(n, FRAMES, 5)``, frame by frame."""
    return np.asarray(np.nanpercentile(np.abs(errors), 95, axis=0))


def simulate(
    scene: Scene, case: Case, runs: int, rng: Generator, batch: int = BATCH
) -> Iterator[Array]:
    """Yield errors by method, m and rad, ``(m, n <= batch, FRAMES, 5)``, nan without a pose."""
    model = ForwardModel(assumed_scene(scene, case))
    moments = calibrate(model, rng)
    estimator = Estimator(model.scene, "least_squares").wait()
    motion = Motion(model, STEP_S)
    for start in range(0, runs, batch):
        offsets = draw_offsets(min(batch, runs - start), rng)
        images = expose(model, case.path, offsets, rng)
        single, tracked = _by_least_squares(estimator, images)
        docking = by_docking(motion, images, single[:, 0])
        poses = dead_reckoned(moments.poses(images)), single, tracked, docking
        yield np.stack(poses) - case.path


def all_cases(scene: Scene, runs: int, seed: int) -> Iterator[tuple[str, Array]]:
    """Yield the name and the errors of `simulate` of case after case, each from the same seed."""
    for name, case in CASES.items():
        for errors in simulate(scene, case, runs, np.random.default_rng(seed)):
            yield name, errors


def gathered(scene: Scene, case: Case, errors: Sequence[Array]) -> ApproachErrors:
    """Return the errors of a case from those of `simulate`, beside its bounds."""
    model = ForwardModel(assumed_scene(scene, case))
    of_methods = dict(zip(METHODS, np.concatenate(errors, axis=1), strict=True))
    run_bound = bound(Motion(model, STEP_S), case.path)
    return ApproachErrors(of_methods, cramer_rao_bound(model, case.path).std, run_bound)


def _by_least_squares(estimator: Estimator, images: Array) -> tuple[Array, Array]:
    """Estimate all frames of all runs, as single images and as a track."""
    single, tracked = np.full((2, len(images), FRAMES, 5), np.nan)
    parameters = scene_parameters(images, estimator.scene)
    for run_number in range(len(images)):
        tracker = Tracker(TrackerSettings())
        for frame, time_s in enumerate(TIMES_S):
            at = run_number, frame
            with suppress(NoPose):
                estimate = estimator.estimate(images[at], parameters[at])
                single[at] = estimate.pose
                stamp_ns = round(time_s * 1e9)
                tracked[at] = tracker.update(stamp_ns, estimate.pose, estimate.covariance).pose
    return single, tracked


def by_docking(motion: Motion, images: Array, first: Array) -> Array:
    """Smooth all runs at once; a run without a `first` pose, shape ``(n, 5)``, gets none."""
    poses, started = np.full((len(images), FRAMES, 5), np.nan), ~np.isnan(first[:, 0])
    if started.any():
        poses[started], _, _ = smoothed(motion, images[started], first[started])
    return poses


def as_object(case: Case, result: ApproachErrors) -> dict[str, Any]:
    """Return a case as plain values, in m and deg; None where the paper gives none."""

    def of_method(errors: Array) -> dict[str, Any]:
        mean = np.nanmean(errors, axis=0)
        off, spread = percentile_95(errors), percentile_95(errors - mean)
        values = {"mean_end": mean[-1], "start_95": off[0], "end_95": off[-1]}
        values |= {"start_95_about_mean": spread[0], "end_95_about_mean": spread[-1]}
        ratio = np.sqrt(np.nanmean(errors**2, axis=0)) / result.bound
        ratios = zip(RANGES_M.round(1)[::5], ratio[::5], strict=True)
        return {
            **{name: by_column(value * IN_DEGREES) for name, value in values.items()},
            "ratio_to_bound": {f"{metres:g} m": by_column(values) for metres, values in ratios},
            "without_pose": int(np.isnan(errors[..., 0]).sum()),
        }

    figures = {
        "runs": len(result.errors[METHODS[0]]),
        "published": {name: by_column(getattr(case, name)) for name in PUBLISHED},
        "aim_end_95": by_column(case.end_95 / AIM),
        "methods": {method: of_method(errors) for method, errors in result.errors.items()},
        "bound_end_95": by_column(SIGMA_95 * result.bound[-1] * IN_DEGREES),
        "run_bound_end_95": by_column(SIGMA_95 * result.run_bound[-1] * IN_DEGREES),
    }
    return plain(figures)


def _row(label: str, values: Mapping[str, float | None]) -> list[str]:
    return [label, *("-" if value is None else f"{value:.3f}" for value in values.values())]


def report(name: str, case: Mapping[str, Any]) -> str:
    """Return the table of a case, from `as_object`."""
    rows: list[Sequence[str]] = [(f"{name}, runs: {case['runs']}", *DOF_NAMES), ("", *DOF_UNITS)]
    for key, title in PRINTED.items():
        rows += [(title,), _row("  published", case["published"][key])]
        for method, values in case["methods"].items():
            rows.append(_row(f"  {method}", values[key]))
            if method == "moments" and key != "mean_end":
                rows.append(_row("    about their mean", values[f"{key}_about_mean"]))
    rows += [
        _row("  the aim", case["aim_end_95"]),
        _row("  bound of one image", case["bound_end_95"]),
        _row("  bound of all, with the motion", case["run_bound_end_95"]),
    ]
    counts = (f"{method} {values['without_pose']}" for method, values in case["methods"].items())
    without = f"frames without a pose, of {case['runs'] * FRAMES}: {', '.join(counts)}"
    return f"{columns(rows)}\n{without}"


PUBLISHED_COLOUR = "#e08a00"
ROWS = {
    "x, along the beam (m)": [0],
    "worse of y, z (m)": [1, 2],
    "worse of pitch, yaw (deg)": [3, 4],
}


def draw(results: Mapping[str, ApproachErrors], about: str) -> Any:
    """Draw 95 % errors against range, a column a case; return the figure."""
    figure = new_figure(max(9.2, 4.6 * len(results)), 10.5)
    grid = figure.subplots(3, len(results), sharex=True, sharey="row", squeeze=False)
    for column, (name, result) in zip(grid.T, results.items(), strict=True):
        for axes, dofs in zip(column, ROWS.values(), strict=True):
            _draw_panel(axes, CASES[name], result, dofs)
        column[0].set_title(f"{name}, K {CASES[name].k_per_m:g} /m", fontsize=12)
        column[-1].set_xlabel("behind the lamp (m)")
    for axes, title in zip(grid[:, 0], ROWS, strict=True):
        axes.set_ylabel(title, fontsize=12)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=11)
    figure.suptitle(f"95 % of errors during an approach; {about}", fontsize=14)
    return figure


def _draw_panel(axes: Any, case: Case, result: ApproachErrors, dofs: list[int]) -> None:
    def worst(values: Array) -> Array:
        return np.asarray((values * IN_DEGREES)[..., dofs].max(axis=-1))

    for method in METHODS:
        errors = worst(percentile_95(result.errors[method]))
        axes.plot(RANGES_M, errors, color=METHOD_COLOURS[method], lw=2, label=method)
    axes.plot(RANGES_M, SIGMA_95 * worst(result.bound), "k--", lw=1.2, label="bound of one image")
    all_so_far = SIGMA_95 * worst(result.run_bound)
    axes.plot(RANGES_M, all_so_far, "k:", lw=1.5, label="bound of all so far")
    ends = RANGES_M[[0, -1]]
    # fmax passes over what the paper does not give.
    published = [np.fmax.reduce(errors[dofs]) for errors in (case.start_95, case.end_95)]
    filled = {"color": PUBLISHED_COLOUR, "ms": 9, "mec": "k", "label": "published"}
    axes.plot(ends, published, "D", **filled, clip_on=False, zorder=5)
    hollow = {"mfc": "w", "mec": PUBLISHED_COLOUR, "mew": 2, "ms": 8, "label": "the aim"}
    axes.plot(ends[-1], (case.end_95 / AIM)[dofs].max(), "D", **hollow, clip_on=False, zorder=6)
    axes.set(yscale="log", xlim=(RANGES_M[0], RANGES_M[-1]))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.grid(alpha=0.4, which="both", lw=0.4)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "eren2017_tank")
    options.add_number(parser, "runs", Quantity("runs of each case", "", 1, 1e6), 100)
    options.add_json(parser)
    outputs.add_picture(parser, "approach.png")


def run(args: argparse.Namespace) -> int:
    """Run the cases, print them and draw them."""
    runs, scene = args.runs, options.scene_of(args)
    output = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    rounds = progress.over(all_cases(scene, runs, SEED), "batch", len(CASES) * -(-runs // BATCH))
    done, whole = until_interrupted(rounds)
    results = {
        name: gathered(scene, CASES[name], [errors for of, errors in done if of == name])
        for name in dict(done)
    }
    cases = {name: as_object(CASES[name], result) for name, result in results.items()}
    save(draw(results, f"seed {SEED}"), output)
    result = {"scene": scene.name, "seed": SEED, "asked_runs": runs, "cases": cases}
    result |= {"picture": str(output)}
    tables = "\n\n".join(report(name, case) for name, case in cases.items())
    text = f"scene {scene.name}; seed {SEED}\n\n{tables}\npicture: {output}"
    return outputs.finish(args, result, text, whole, "only complete runs count")
