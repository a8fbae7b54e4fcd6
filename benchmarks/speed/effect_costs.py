"""What each effect of a scene costs: ``python benchmarks/speed/effect_costs.py``.

Time for a million readings of the ideal light plus one effect, over that of the ideal light alone,
measured in turns in one run; the median of the rounds. The second column is a single image.
"""

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from uuv_optical_array.forward.effects import EFFECTS
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, scene_from_settings

sys.path.append(str(Path(__file__).parents[2] / "test/shared"))
from effect_settings import middle_settings

SETTINGS = {name: middle_settings(name) for name in EFFECTS}
IDEAL, WHOLE = "ideal light", "all of them"
MILLION = 40_000  # images of 25 readings
POSES = np.random.default_rng(1).uniform(
    [-8, -0.6, -0.6, -0.35, -0.35], [-4, 0.6, 0.6, 0.35, 0.35], (MILLION, 5)
)


def model(**chosen: Any) -> ForwardModel:
    """Return the reference scene with these effects and no others."""
    settings = load_scene("reference").settings()
    return ForwardModel(scene_from_settings({**settings, "effects": chosen}, "costs"))


def models() -> dict[str, ForwardModel]:
    """Return a model for nothing, each effect, and all."""
    alone = {name: model(**{name: values}) for name, values in SETTINGS.items()}
    return {IDEAL: model(), **alone, WHOLE: model(**SETTINGS)}


def costs(poses: Any, rounds: int, number: int = 1) -> dict[str, float]:
    """Return the seconds of one call by name, medians over rounds in which all take turns."""
    rng = np.random.default_rng(2)

    def seconds(call: Callable[..., Any]) -> float:
        start = time.perf_counter()
        for _ in range(number):
            call(poses, rng, time_s=12.3)
        return (time.perf_counter() - start) / number

    calls = {name: one.expose for name, one in models().items()}
    for call in calls.values():
        call(poses, rng, time_s=12.3)
    # Forwards and backwards, so that nobody always follows the same neighbour.
    turns = [list(calls), list(reversed(calls))]
    taken = [{name: seconds(calls[name]) for name in turns[i % 2]} for i in range(rounds)]
    return {
        name: statistics.median(one[name] / one[IDEAL] for one in taken)
        * statistics.median(one[IDEAL] for one in taken)
        for name in calls
    }


def report(rounds: int = 15) -> str:
    """Measure and return the table."""
    many, single = costs(POSES, rounds), costs(POSES[0], 4 * rounds, 20)
    each = f"{many[IDEAL]:.3f} s a million readings, {1e6 * single[IDEAL]:.0f} us an image"
    lines = [
        f"ideal light: {each}",
        f"{'':<18}{'a million readings':>20}{'one image':>12}",
    ]
    for name in many:
        ratios = many[name] / many[IDEAL], single[name] / single[IDEAL]
        lines.append(f"{name:<18}{ratios[0]:>18.2f} x{ratios[1]:>10.2f} x")
    return "\n".join(lines)


if __name__ == "__main__":
    print(report())
