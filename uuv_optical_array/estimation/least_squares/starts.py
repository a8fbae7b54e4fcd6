"""Where the fits of an image start: from poses whose images look alike."""

import math
from typing import Any, NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import YAW, Array
from uuv_optical_array.core.numerics.elementwise import indices
from uuv_optical_array.estimation.least_squares.thinned import (
    kept_of,
    readings_of,
    thinned_blur,
    thinned_optics,
)
from uuv_optical_array.estimation.signature.features import (
    lifted,
    scene_parameters,
    write_parameters,
)
from uuv_optical_array.estimation.signature.spectral_angle import unit_vectors
from uuv_optical_array.estimation.signature_table import MIN_PEAK_COUNTS, grid_axes, no_light
from uuv_optical_array.forward.many_poses import write_arriving
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.optics import Optics, detect

# Poses of the working volume from which fits may start; more do not improve the fits.
STARTS = 1024
# Beside them poses nearer than that, and the share of the range that they go down to; and as many
# down to this share of the least range, the farther off the beam's axis the nearer.
NEAR_STARTS, NEAREST, ASIDE = 4096, 0.2, 0.15
TURNED = math.radians(120)  # up to which yaw as many as the first look past the lamp
RING = 12  # starts of a planar array, whose minima lie about a ring of attitudes
BY_SIGNATURE = 1536  # of all these are looked up by their signature, too, and the others by image


class Guide(NamedTuple):
    """What a table says about where to start, and when a fit is good.

    Of large arrays all this is of the detectors that are kept, see `thinned`.

    - units: directions of signatures, of length one, by columns, shape ``(6, m)``.
    - poses: of these and more, m and rad, shape ``(k, 5)``.
    - roots: square roots of their readings, by columns, shape ``(n, k)``.
    - weights: of the five key parameters, and the constant that is appended, shape ``(6,)``.
    - candidates: rows to start from, unless few detectors are lit; at least `RING` if planar.
    - max_score: score of the misfit beyond which a fit is no pose.
    - gaussian: whether the posterior is taken as linear at the best minimum, not integrated.
    - side, full_scale_counts, subdetector: as of `features.write_parameters`.
    - readings, blur: that are kept, as of `thinned.thinned`, shapes ``(n,)`` and ``(side, side)``.
    """

    units: Array
    poses: Array
    roots: Array
    weights: Array
    candidates: int
    max_score: float
    gaussian: bool
    side: int
    full_scale_counts: float
    subdetector: bool
    readings: Any
    blur: Array


def guide_of(model: ForwardModel, candidates: int, max_score: float) -> Guide:
    """Return the guide of a model's images; ValueError for a scene without light."""
    scene, whole = model.scene, model.array.side
    side, lamps = len(kept_of(whole)), scene.lamp_count
    readings, optics = readings_of(whole, lamps), model.optics()
    blur = thinned_blur(optics.blur, whole)
    poses = drawn_poses(grid_axes(scene.table))
    images = model.converted(light_of(thinned_optics(optics, readings, blur), poses))
    lit = images.max(axis=1) - model.noise.black >= MIN_PEAK_COUNTS
    if not lit.any():
        raise no_light(scene)
    poses, images = poses[lit], images[lit]
    first = images[:BY_SIGNATURE].reshape(-1, lamps * side, side)
    vectors = lifted(scene_parameters(first, scene), scene.signature, side)
    if scene.array.shape == "planar" and not scene.lamps:
        candidates = max(candidates, RING)
    return Guide(
        np.ascontiguousarray(unit_vectors(vectors).T),
        poses,
        np.ascontiguousarray(np.sqrt(np.maximum(images, 0.0)).T),
        lifted(np.ones(5), scene.signature, side),
        candidates,
        max_score,
        bool(scene.lamps),
        side,
        float(scene.full_scale_counts),
        scene.signature.peak == "subdetector",
        readings,
        blur,
    )


def drawn_poses(axes: list[Array]) -> Array:
    """Return poses that fits may start from, by the axes of a grid; the same at each call.

    So an image always has the same answer.
    """
    rng = np.random.default_rng(0)

    def drawn(count: int) -> Array:
        # Points of the grid: from its edges fits find minima that they miss from within.
        return np.stack([rng.choice(axis, count) for axis in axes], axis=-1)

    poses = drawn(STARTS)
    # Nearer than that the array saturates, and no fit from far away leads there.
    near = drawn(NEAR_STARTS)
    near[:, :3] *= rng.uniform(NEAREST, 1, (len(near), 1))
    aside = drawn(NEAR_STARTS)
    share = np.exp(rng.uniform(math.log(ASIDE), 0, NEAR_STARTS))
    aside[:, 0] = share * axes[0].max()
    aside[:, 1:3] *= np.sqrt(share)[:, None]
    # An array that is turned away sees its lamp by the edge alone.
    turned = drawn(STARTS)
    turned[:, :3] *= np.exp(rng.uniform(math.log(NEAREST), 0, STARTS))[:, None]
    turned[:, YAW] = rng.uniform(-TURNED, TURNED, STARTS)
    return np.concatenate([poses, near, aside, turned])


def light_of(optics: Optics, poses: Array) -> Array:
    """Return the light at poses of level followers, counts, shape ``(m, n)``."""
    arriving = np.empty((optics.step_values.shape[1], len(poses)))
    with np.errstate(under="ignore"):  # light too dim for a float64 counts as none
        write_arriving(optics, np.ascontiguousarray(poses.T), arriving)
        image = np.ascontiguousarray(arriving.T)[None]
        detect(optics, np.zeros((0, len(poses), 1)), image)
    return image[0]


def direction(readings: Array, guide: Guide) -> Array:
    """Return the direction of an image's signature, of length one, shape ``(6,)``."""
    # Computed here even where the caller knows it, which is less code than to pass it down.
    count, parameters = guide.side * guide.side, np.empty((5, 1))
    column = np.zeros((count, 1))  # the images of all lamps together
    kept = guide.readings
    for i in range(len(kept)):
        column[i % count, 0] += readings[kept[i]]
    write_parameters(column, guide.side, guide.full_scale_counts, guide.subdetector, parameters)
    unit = guide.weights.copy()
    for i in range(5):
        unit[i] *= parameters[i, 0]
    length = 0.0
    for i in range(len(unit)):
        length += unit[i] * unit[i]
    length = np.sqrt(length)
    for i in range(len(unit)):
        unit[i] /= length
    return unit


def nearest_rows(units: Array, unit: Array, count: int) -> tuple[Any, Any]:
    """Return the rows of least chord to a direction, nearest first."""
    squares = np.zeros(units.shape[1])
    for k in range(len(unit)):
        for j in indices(len(squares)):
            off = units[k, j] - unit[k]
            squares[j] += off * off
    rows, nearest = least_of(squares, count)
    return rows, np.sqrt(nearest)


def least_of(values: Array, count: int) -> tuple[Any, Array]:
    """Return the places of the least values, least first, and these; 0 and inf: there are fewer."""
    places, least = np.zeros(count, dtype=np.int64), np.full(count, np.inf)
    for i in range(len(values)):
        if values[i] < least[count - 1]:
            k = count - 1
            while k > 0 and least[k - 1] > values[i]:
                least[k], places[k] = least[k - 1], places[k - 1]
                k -= 1
            least[k], places[k] = values[i], i
    return places, least


def roots_of(readings: Array) -> Array:
    """Return square roots of readings, whose noise is the same for all; 0 below darkness."""
    roots = readings.copy()
    for j in range(len(roots)):
        roots[j] = np.sqrt(max(roots[j], 0.0))
    return roots


def rows_alike(readings: Array, guide: Guide, unit: Array, count: int) -> Any:
    """Return rows of least chord, and as many whose images are most alike, by turns.

    They are so many, or as many as have a signature.
    """
    rows, _ = nearest_rows(guide.units, unit, min(count, guide.units.shape[1]))
    alike, _ = nearest_rows(guide.roots, roots_of(readings), len(rows) // 2)
    for k in range(len(rows) - 1, 0, -1):
        rows[k] = alike[k // 2] if k % 2 == 1 else rows[k // 2]
    return rows
