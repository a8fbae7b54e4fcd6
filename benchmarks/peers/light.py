"""The light at very many random poses, timed against the exponentials alone."""

import time
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from uuv_optical_array.estimation.signature_table import grid_axes
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene

ROUNDS = 11


def simulate(
    scene: Scene,
    count: int,
    rng: np.random.Generator,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> dict[str, Any]:
    """Time the light at random poses, and the exponentials of as many readings."""
    model = ForwardModel(scene)
    low, high = np.transpose([axis[[0, -1]] for axis in grid_axes(scene.table)])
    poses = rng.uniform(low, high, (count, 5))
    side = scene.array.detectors_per_side
    exponents = rng.uniform(-20, 0, (count, side, side))
    images = np.empty_like(exponents)
    times: dict[str, list[float]] = {}

    def timed(name: str, work: Any) -> None:
        begin = time.perf_counter()
        work()
        times.setdefault(name, []).append(time.perf_counter() - begin)

    for _ in progress(range(ROUNDS + 1)):
        timed("floor", lambda: np.exp(exponents, out=images))
        timed("numpy", lambda: model.light(poses))
    # The first round warms up. Ratios are those within a round: the machine's load changes.
    rounds = {name: np.array(values[1:]) for name, values in times.items()}
    median = {name: float(np.median(values)) for name, values in rounds.items()}

    def ratio(name: str, to: str) -> float:
        return float(np.median(rounds[name] / rounds[to]))

    return {
        "poses": count,
        "detectors": side * side,
        "floor_s": median["floor"],
        "numpy": {"poses_per_s": count / median["numpy"], "times_floor": ratio("numpy", "floor")},
    }
