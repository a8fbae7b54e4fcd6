"""What each departure of the kernel from plain Numba earns: compiling and frames without it.

A row is a process of its own that compiles the fit into an empty cache, then estimates lit images;
the yardstick of `frames` runs between them. Ratios are to all of them together, which is the first
row, and again the last. Names as words: those rows alone, of several departures between commas.
"""

import gc
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from frames import cpu_us, example, yardstick

from uuv_optical_array import Estimator, ForwardModel, load_scene
from uuv_optical_array.core.numerics import compilation, elementwise, linked_functions
from uuv_optical_array.estimation.fit_compiler import compile_fit
from uuv_optical_array.forward.working_volume import lit_poses

IMAGES, REPEATS = {"follow": 60, "night_plume": 20}, 6
AS_IT_IS, PLAIN = "as it is", "plain Numba"


def without_linking() -> None:
    """Let Numba emit inner functions, too."""
    linked_functions.TRIED = ()  # type: ignore[assignment]


def without_polynomials() -> None:
    """Take Numba's exponential function."""
    from uuv_optical_array.core.numerics.compiled_math import INSTEAD

    INSTEAD[elementwise.exp], INSTEAD[elementwise.expm1] = np.exp, np.expm1


def without_borrowing() -> None:
    """Count references to the arrays of a frame in each function."""
    from uuv_optical_array.core.numerics.compiled_math import INSTEAD, one_value

    INSTEAD[elementwise.borrowed] = one_value


def without_privacy() -> None:
    """Let the compiler believe that others call inner functions, too."""
    del linked_functions._OuterLibrary._optimize_final_module


def without_entry() -> None:
    """Look up the types of all arguments at each call."""
    compilation.entry = lambda ready, *_: ready  # type: ignore[assignment]


def with_options(**changed: Any) -> Callable[[], None]:
    """Return what changes options of functions; ``None``: the option is not given."""

    def change() -> None:
        options = compilation.options

        def others(function: Any, inner: bool) -> dict[str, Any]:
            given = options(function, inner) | changed
            return {name: value for name, value in given.items() if value is not None}

        compilation.options = others

    return change


WITHOUT: dict[str, Callable[[], None]] = {
    "linked functions": without_linking,
    "private functions": without_privacy,
    "borrowed arrays": without_borrowing,
    "types looked up once": without_entry,
    "exp and expm1": without_polynomials,
    "laws inlined": with_options(forceinline=None),
    "fastmath": with_options(fastmath=False),
    "no wrappers": with_options(no_cpython_wrapper=None, no_cfunc_wrapper=None),
}
VECTORS = "exp and expm1, laws inlined, fastmath"  # what loops need together to become vectors


def measure(name: str) -> dict[str, float]:
    """Compile without a departure, and estimate; returns CPU seconds and medians in yardsticks."""
    for departure, remove in WITHOUT.items():
        if name == PLAIN or departure in name.split(", "):
            remove()
    gc.disable()
    before = time.process_time()
    compile_fit()
    figures = {"compiling, s": time.process_time() - before}
    gc.enable()
    rng = np.random.default_rng(1)
    asked_of_unit = example(rng)
    yardstick(*asked_of_unit)
    for scene_name, count in IMAGES.items():
        scene = load_scene(scene_name)
        model, estimator = ForwardModel(scene), Estimator(scene).wait()
        images = model.expose(lit_poses(model, count, rng), rng)
        times, units = np.empty((2, REPEATS, count))
        for k in range(REPEATS):
            for i, image in enumerate(images):
                units[k, i] = cpu_us(yardstick, *asked_of_unit)
                times[k, i] = cpu_us(estimator.estimate, image)
        figures[scene_name] = float(np.median(times.min(axis=0)) / np.median(units.min(axis=0)))
    return figures


def main() -> None:
    """Print a row for each departure that is left out, and for all of them."""
    if sys.argv[1:2] == ["--row"]:
        print(json.dumps(measure(sys.argv[2])))
        return
    first: dict[str, float] = {}
    for name in sys.argv[1:] or (AS_IT_IS, *WITHOUT, VECTORS, PLAIN, AS_IT_IS):
        with tempfile.TemporaryDirectory() as empty:
            program = [sys.executable, __file__, "--row", name]
            variables = {**os.environ, "NUMBA_CACHE_DIR": empty}
            done = subprocess.run(
                program, stdout=subprocess.PIPE, text=True, env=variables, check=True
            )
        row = json.loads(done.stdout.splitlines()[-1])
        first = first or row
        cells = (f"{key} {row[key]:.1f} ({row[key] / first[key]:.2f})" for key in row)
        print(f"{name:40}", *cells, sep="  ", flush=True)


if __name__ == "__main__":
    main()
