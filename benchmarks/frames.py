"""CPU time of a frame, beside a plain compiled Gauss-Newton fit, in one run.

The yardstick is four iterations on 25 detectors, with no prior, no search and no covariance: what
the arithmetic of a fit takes at least. Ratios to it carry over between machines; it runs between
the frames, so that a noisy machine slows both.
"""

import dataclasses
import math
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from uuv_optical_array import Estimator, ForwardModel, build_table, load_scene
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.estimation.signature_table import grid_parameters, table_compiler
from uuv_optical_array.forward.prior import PriorSettings
from uuv_optical_array.forward.scene import Scene, scene_from_settings
from uuv_optical_array.forward.working_volume import lit_poses

FRAMES = 300
NUISANCES = PriorSettings(
    lamp_power_std=0.1, absorption_std_per_m=0.02, ambient_std_counts=5.0, temperature_std_c=1.0
)


@njit(error_model="numpy", fastmath={"contract"})
def yardstick(detectors, readings, start):
    """Fit a bright point with a Gaussian beam by four Gauss-Newton steps; returns the place."""
    at = start.copy()
    for _ in range(4):
        joint, pull = np.zeros((5, 5)), np.zeros(5)
        for j in range(detectors.shape[1]):
            x, y, z = at[0] - detectors[0, j], at[1] - detectors[1, j], at[2] - detectors[2, j]
            square = x * x + y * y + z * z
            r = math.sqrt(square)
            facing = (x * detectors[3, j] + y * detectors[4, j] + z * detectors[5, j]) / r
            along = (x * math.cos(at[4]) + y * math.sin(at[4]) + z * math.sin(at[3])) / r
            light = 1e4 * facing / square * math.exp((along - 1) * 30)
            slopes = (
                light * (x - 2 * x / square),
                light * (y - 2 * y / square),
                light * (z - 2 * z / square),
                light * along,
                light * facing,
            )
            off = readings[j] - light
            for q in range(5):
                pull[q] += slopes[q] * off
                for s in range(q + 1):
                    joint[q, s] += slopes[q] * slopes[s]
        for i in range(5):
            joint[i, i] += 1e-3
            for k in range(i + 1):
                rest = joint[i, k]
                for m in range(k):
                    rest -= joint[i, m] * joint[k, m]
                joint[i, k] = math.sqrt(abs(rest) + 1e-9) if i == k else rest / joint[k, k]
        for i in range(5):
            rest = pull[i]
            for k in range(i):
                rest -= joint[i, k] * pull[k]
            pull[i] = rest / joint[i, i]
        for i in range(4, -1, -1):
            rest = pull[i]
            for k in range(i + 1, 5):
                rest -= joint[k, i] * pull[k]
            pull[i] = rest / joint[i, i]
        for q in range(5):
            at[q] += 1e-9 * pull[q]
    return at


def example(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return arguments of the yardstick: detectors, readings and start."""
    return rng.random((6, 25)), rng.random(25), np.array([6.0, 0.2, 0.2, 0.2, 0.2])


def cpu_us(call: Callable[..., Any], *arguments: Any) -> float:
    """Return the CPU time of a call, us."""
    before = time.thread_time_ns()
    call(*arguments)
    return (time.thread_time_ns() - before) / 1e3


def weakly_curved() -> Scene:
    """Return `reference` with a 7 x 7 array on a sphere of 0.6 m, a narrow beam and 12 bits."""
    values = load_scene("reference").settings()
    values["array"].update(detectors_per_side=7, radius_m=0.6)
    values["lamp"].update(beam_sigma_deg=5.0, reference_counts=3600.0)
    values["effects"]["attenuation"]["k_per_m"] = 0.25
    values["effects"]["saturation"]["level_counts"] = 4095.0
    values["effects"]["adc"]["bits"] = 12
    return scene_from_settings(values, "weakly curved")


def with_nuisances() -> Scene:
    """Return `coastal` with daylight and four nuisances under a prior."""
    values = load_scene("coastal").settings()
    values["effects"]["ambient"] = {"level_counts": 20.0}
    values["prior"] = dataclasses.asdict(NUISANCES)
    return scene_from_settings(values, "nuisances")


class Row(NamedTuple):
    """CPU times of one case."""

    name: str
    median_us: float
    late_us: float  # 99th percentile
    yardstick_us: float
    without: int  # frames that got no pose


def measure() -> Iterator[Row]:
    """Yield a row for each case, of `FRAMES` frames."""
    rng = np.random.default_rng(1)
    asked_of_unit = example(rng)
    yardstick(*asked_of_unit)
    reference = load_scene("reference")
    cases = {
        "least_squares, reference": (reference, "least_squares"),
        "least_squares, follow": (load_scene("follow"), "least_squares"),
        "follow, drawn seas": (load_scene("follow"), "least_squares"),
        "four nuisances": (with_nuisances(), "least_squares"),
        "planar 5 x 5": (reference.with_shape("planar"), "least_squares"),
        "weakly curved 7 x 7": (weakly_curved(), "least_squares"),
        "sam, held to the image": (reference, "sam"),
        "sam, key parameters alone": (reference, "sam"),
    }
    for name, (scene, method) in cases.items():
        estimator = Estimator(build_table(scene), method).wait()
        model = ForwardModel(scene)
        poses = lit_poses(model, FRAMES, rng)
        stds = scene.prior.nuisance_std() if name.endswith("drawn seas") else {}
        seas = {of: std * rng.standard_normal(FRAMES) for of, std in stds.items()}
        frames = model.expose(poses, rng, offsets=seas)
        full_scale, alone = scene.full_scale_counts, name.endswith("alone")
        parameters = key_parameters(frames, full_scale, scene.signature.peak)
        asked = [(None, each) for each in parameters] if alone else [(each,) for each in frames]
        estimator.estimate(*asked[0])
        times, units, without = [], [], 0
        for arguments in asked:
            units.append(cpu_us(yardstick, *asked_of_unit))
            try:
                times.append(cpu_us(estimator.estimate, *arguments))
            except NoPose:
                without += 1
        middle, late = np.quantile(times, [0.5, 0.99])
        yield Row(name, middle, late, float(np.median(units)), without)


class Cost(NamedTuple):
    """CPU time of a call, alone and beside the yardstick, which runs before and after it."""

    s: float
    yardsticks: float


def cost_of(call: Callable[..., Any], *arguments: Any, repeats: int) -> Cost:
    """Return the medians of what a call costs."""
    asked = example(np.random.default_rng(1))

    def unit_us() -> float:
        return float(np.median([cpu_us(yardstick, *asked) for _ in range(200)]))

    unit_us()
    times, ratios = [], []
    for _ in range(repeats):
        before, spent, after = unit_us(), cpu_us(call, *arguments), unit_us()
        times.append(spent / 1e6)
        ratios.append(2 * spent / (before + after))
    return Cost(float(np.median(times)), float(np.median(ratios)))


def million_signatures() -> Cost:
    """Return what a million signatures of `reference` cost, by a hundredth of them, compiled."""
    table_compiler().wait()
    model = ForwardModel(load_scene("reference"))
    cost = cost_of(grid_parameters, model, range(10_000), repeats=41)
    return Cost(100 * cost.s, 100 * cost.yardsticks)


def table_s() -> float:
    """Return the CPU time of the table of `follow`, 371,293 rows, compiled."""
    table_compiler().wait()
    return min(cpu_us(build_table, load_scene("follow")) for _ in range(3)) / 1e6


def main() -> None:
    """Print a table of medians and 99th percentiles."""
    print(f"{'':26}{'median':>10}{'99 %':>10}{'median':>12}{'99 %':>10}  no pose")
    print(f"{'':26}{'us':>10}{'us':>10}{'yardsticks':>12}")
    for name, middle, late, unit, without in measure():
        print(
            f"{name:26}{middle:10.0f}{late:10.0f}{middle / unit:12.0f}{late / unit:10.0f}"
            f"  {without} of {FRAMES}; yardstick {unit:.1f} us"
        )
    million = million_signatures()
    print(f"a million signatures: {million.s:.2f} s, {million.yardsticks:.0f} yardsticks")
    print(f"the table of follow: {table_s():.2f} s")


if __name__ == "__main__":
    main()
