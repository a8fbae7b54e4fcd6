"""Parts of the fit of an image, put together from the public ones as the estimator does."""

import functools

from scipy.special import ndtri

from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.estimator import EstimatorSettings
from uuv_optical_array.estimation.least_squares.frame import (
    BELIEVED,
    LINEARISED,
    NOWHERE,
    estimate_frame,
    frame_result,
    new_rows,
)
from uuv_optical_array.estimation.least_squares.frame_kinds import frame_kinds
from uuv_optical_array.estimation.least_squares.image_fit import ImageFit, pose_prior
from uuv_optical_array.estimation.least_squares.problem import Problem
from uuv_optical_array.estimation.least_squares.starts import guide_of
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene


def kinds_of(model):
    """Return the kinds of frame of a model's scene, clear ones first."""
    return frame_kinds(model, *pose_prior(model.scene))


def guide_to(model, candidates=EstimatorSettings.candidates):
    """Return where fits of a model's scene start from."""
    return guide_of(model, candidates, float(-ndtri(EstimatorSettings.max_misfit)))


def frame_of(problem, guide):
    """Return what fits frames like these, compiled where it can be."""
    frame = estimate_frame
    if compilation.installed():
        frame = compilation.prepare(
            estimate_frame, problem, guide, BELIEVED, NOWHERE, new_rows(problem)
        )

    return functools.partial(frame_result, frame)


@functools.cache
def writer_of_fits():
    """Return what writes as `write_linear` does, by what fits frames: it is compiled once for all.

    By itself each process would compile it again.
    """
    model = ForwardModel(load_scene("reference"))  # it is the same in every scene
    problem, guide = kinds_of(model)[0].problem, guide_to(model)
    frame = frame_of(problem, guide).args[0]

    def write(optics, noise, readings, at, roll, linear):
        given = {"optics": optics, "noise": noise, "readings": readings, "roll": roll}
        frame(problem._replace(**given), guide, LINEARISED, at, linear)

    return write


def fit_of(estimator):
    """Return a fit of an estimator's scene like its own."""
    s, model = estimator.settings, ForwardModel(estimator.scene)
    compiled = compilation.installed()
    return ImageFit(model, estimator.constants, s.candidates, s.max_misfit, compiled)


class CountedProblem(Problem):
    """A problem that counts how often its posterior is evaluated, which reads its prior once."""

    evaluations = 0

    @property
    def pose_mean(self):
        self.evaluations += 1
        return tuple(self)[Problem._fields.index("pose_mean")]
