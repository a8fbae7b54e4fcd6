"""What Eren et al. (2016) leave open, filled in otherwise, one choice at a time."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from uuv_optical_array.core.geometry import Array, rotation_matrix
from uuv_optical_array.estimation.signature.features import key_parameters, skewness
from uuv_optical_array.forward.effects import check_effects
from uuv_optical_array.forward.effects.water import hanning_blur
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.studies.shared.separation import (
    RECONSTRUCTION,
    Choice,
    paper_signature,
    scene_signature,
)


def alternatives(rng: np.random.Generator) -> list[Choice]:
    """Return the reconstruction, and choices that differ from it in one thing each."""
    return [
        RECONSTRUCTION,
        *(Choice(f"beam sigma {deg:g} deg", _beam(deg)) for deg in (3.0, 4.0, 5.0, 6.0, 8.0)),
        *(Choice(f"attenuation {k:g} /m", _with(attenuation={"k_per_m": k})) for k in (0.05, 0.2)),
        Choice("no blur", _with(forward_scatter=None)),
        *(Choice(f"blur {m:g} m wide", _with(forward_scatter={"window_m": m})) for m in (0.1, 0.4)),
        Choice("blur of 11 detectors always", _blur_of_11_detectors),
        Choice("blur, dark beyond the border", images=_dark_border),
        Choice(
            "peak between detectors",
            signature=lambda images, top, _: paper_signature(images, top, "subdetector"),
        ),
        Choice("column, row from 0", signature=_placed(lambda c, n: (c + (n + 1) / 2) / n - 1 / n)),
        Choice("column, row from the centre", signature=_placed(lambda c, n: c / n)),
        Choice("the same, per half width", signature=_placed(lambda c, n: c * (2 / (n - 1)))),
        Choice(
            "peak over full scale",
            signature=lambda images, _, scene: scene_signature(
                images, scene.full_scale_counts, scene
            ),
        ),
        Choice("sample skewness", signature=_sample_skewness),
        Choice("skewness of differences", signature=_differences),
        Choice("moves to port", poses=lambda poses, scene: poses * [1, -1, 1, 1, -1]),
        Choice("yaw about the array", poses=_about_array),
        Choice("10 bits", _with(**TEN_BITS), images=ForwardModel.expose),
        noisy(rng),
    ]


TEN_BITS: dict[str, Any] = {"adc": {"bits": 10}, "sensor_noise": None, "shot_noise": None}


def noisy(rng: np.random.Generator, draws: int = 25) -> Choice:
    """Return the choice with noise: 10 bits, 1 count, the mean of `draws` pairs of images."""

    def read(model: ForwardModel, poses: Array) -> Array:
        return model.expose(np.broadcast_to(poses, (draws, *poses.shape)), rng)

    change = _with(**{**TEN_BITS, "sensor_noise": {"sigma_counts": 1.0}})
    return Choice("10 bits, noise of 1 count", change, images=read)


def _beam(sigma_deg: float) -> Callable[[Scene], Scene]:
    return lambda scene: dataclasses.replace(
        scene, lamp=dataclasses.replace(scene.lamp, beam_sigma_deg=sigma_deg)
    )


def _with(**changed: dict[str, Any] | None) -> Callable[[Scene], Scene]:
    """Change effects, or leave out those that are None."""

    def change(scene: Scene) -> Scene:
        effects = {**scene.effects, **changed}
        kept = {name: values for name, values in effects.items() if values is not None}
        return dataclasses.replace(scene, effects=check_effects(kept))

    return change


def _blur_of_11_detectors(scene: Scene) -> Scene:
    spacing_m = scene.array.width_m / (scene.array.detectors_per_side - 1)
    # The first and the last of the 11 samples are zero.
    return _with(forward_scatter={"window_m": 10 * spacing_m})(scene)


def _dark_border(model: ForwardModel, poses: Array) -> Array:
    """Blur without mirroring: beyond the outermost detectors there is no light."""
    blur = model.scene.effects.get("forward_scatter")
    if blur is None:
        return model.expected(poses)
    bare = ForwardModel(_with(forward_scatter=None)(model.scene))
    bare.power = model.power
    side = model.array.side
    # The middle of a blur three times as wide meets no mirror.
    wide = hanning_blur(3 * side, model.array.spacing_m, blur["window_m"])
    matrix = wide[side : 2 * side, side : 2 * side]
    return matrix @ bare.expected(poses) @ matrix.T


def _about_array(poses: Array, scene: Scene) -> Array:
    """Turn about the array's centre: it stays where the aligned one is."""
    bow = rotation_matrix(poses[:, 3], poses[:, 4])[..., 0]
    moved = poses.copy()
    moved[:, :3] += scene.array.bow_m * (np.array([1.0, 0.0, 0.0]) - bow)
    return moved


def _placed(place: Callable[[Array, int], Array]) -> Callable[[Array, float, Scene], Array]:
    """Return a signature whose column and row are found from those off the centre, of n."""

    def signature(images: Array, on_axis_counts: float, scene: Scene) -> Array:
        vectors = key_parameters(images, on_axis_counts, scene.signature.peak)
        vectors[..., 1:3] = place(vectors[..., 1:3], images.shape[-1])
        return vectors

    return signature


def _sample_skewness(images: Array, on_axis_counts: float, scene: Scene) -> Array:
    vectors = scene_signature(images, on_axis_counts, scene)
    n = images.shape[-1]
    vectors[..., 3:] *= np.sqrt(n * (n - 1)) / (n - 2)
    return vectors


def _differences(images: Array, on_axis_counts: float, scene: Scene) -> Array:
    """Take differences of neighbours, one fewer than detectors, for the gradient."""
    vectors = scene_signature(images, on_axis_counts, scene)
    peak = key_parameters(images, on_axis_counts, "detector")[..., 1:3]
    column, row = np.moveaxis((peak + (images.shape[-1] - 1) / 2).round().astype(int), -1, 0)
    horizontal = np.take_along_axis(images, row[..., None, None], axis=-2)[..., 0, :]
    vertical = np.take_along_axis(images, column[..., None, None], axis=-1)[..., 0]
    vectors[..., 3] = skewness(np.diff(horizontal))
    vectors[..., 4] = skewness(np.diff(vertical))
    return vectors
