"""The fit compiled in the background, so that no frame waits for the compiler."""

from functools import cache

from uuv_optical_array.core.numerics.background import BackgroundCompiler, marked
from uuv_optical_array.estimation.least_squares.image_fit import ImageFit
from uuv_optical_array.estimation.unknowns.constants import constants_of
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

LOAD_S = 5.0  # longest that an estimator waits for what is compiled already
DONE, EXAMPLE = "fit.done", "reference"  # it is the same in every scene


def compile_fit() -> None:
    """Compile what ``least_squares`` runs in any scene, or load it from disk."""
    with marked(DONE):
        model = ForwardModel(load_scene(EXAMPLE))
        ImageFit(model, constants_of(model), candidates=1, max_misfit=0.5, compiled=True)


@cache
def fit_compiler() -> BackgroundCompiler:
    """Return the compiler of the fit, one in a process."""
    return BackgroundCompiler(compile_fit, DONE, LOAD_S)
