"""The light at very many random poses, timed against the exponentials alone."""

import time
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from uuv_optical_array.estimation.table.signature_table import grid_axes
from uuv_optical_array.forward import light_batch
from uuv_optical_array.forward.light import lamp_in_body
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
    start = time.perf_counter()
    fast = light_batch.installed()
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

    for _ in progress(range(ROUNDS + 1)):
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
