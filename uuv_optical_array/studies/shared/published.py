"""The two published estimators, rebuilt from their descriptions, to stand beside ours.

`LookUp` is that of the dissertation behind the 2016 paper (F. Eren, University of New Hampshire,
2015). Of the poses of a table that peak at the image's detector, the one of least cost
``c1 |dSk_h| + c2 |dSk_v| + c3 |dSAM|`` wins, with the differences in both skewnesses and in the
spectral angle. The author dropped it as slow; sorted by the peak's detector, it is fast enough.

`MomentCalibration` is the image-moments method of Eren et al. (Sensors 2017, 17(8), 1741). Range
comes from the peak reading, pitch and yaw from ratios of image moments, by calibrated lines.
Position across is measured in the first frame only, then dead reckoned along the heading. The
paper's text and equations disagree on which ratio is pitch; M23 is odd in y, so here it gives yaw.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import PITCH, YAW, Array, X, Y, Z
from uuv_optical_array.core.settings import Span
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.estimation.signature.spectral_angle import unit_vectors
from uuv_optical_array.estimation.signature_table import SignatureTable
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, TableSettings

# The dissertation's grid: 4 to 8 m by 1 m, 0.3 m across by 0.03 m, 30 deg by 3 deg.
_ACROSS, _TURNED = Span(-0.3, 0.3, 21), Span(-30.0, 30.0, 21)
GRID = TableSettings(Span(-8.0, -4.0, 5), _ACROSS, _ACROSS, _TURNED, _TURNED)
# The calibration of 2017: 125 positions of an array that looks ahead, and turns on the beam's axis.
RANGES_M = np.arange(4.5, 9.0, 1.0)
ACROSS_M = np.linspace(-0.6, 0.6, 5)
# The paper's z runs to one side, 0 to 0.8 m; here below the lamp, where its dive ends.
DOWN_M = np.linspace(-0.8, 0.0, 5)
TURNS_RAD = np.radians(np.arange(-15.0, 16.0))
SAMPLES = 200  # images at each pose
# Of both skewnesses and the angle in the look-up's cost; the author found the ratios by trial.
WEIGHTS = (1.0, 1.0, 16.0)


def lookup_scene(scene: Scene) -> Scene:
    """Return the scene with the dissertation's grid, and its peak at a whole detector."""
    signature = dataclasses.replace(scene.signature, peak="detector")
    return dataclasses.replace(scene, table=GRID, signature=signature)


def _lit(image: ArrayLike, side: int) -> Array:
    """Return an image of some light; NoPose for any other."""
    image = np.asarray(image, dtype=float)
    if image.shape != (side, side) or not np.isfinite(image).all():
        raise NoPose(f"no image: {side} x {side} finite readings are needed")
    if image.max() <= 0:
        raise NoPose(f"no light: the peak is {image.max():g} counts")
    return image


class LookUp:
    """Look-up of poses in a table of a `lookup_scene`; ValueError for peaks between detectors."""

    def __init__(self, table: SignatureTable, weights: ArrayLike = WEIGHTS) -> None:
        scene = table.scene
        if (peak := scene.signature.peak) != "detector":
            raise ValueError(f"table: signature.peak is {peak!r}; the look-up needs 'detector'")
        self._full_scale_counts = scene.full_scale_counts
        self._weights = np.asarray(weights)
        self._side = scene.array.detectors_per_side
        detectors = self._detector(table.parameters)
        order = np.argsort(detectors, kind="stable")
        self._starts = np.searchsorted(detectors[order], np.arange(self._side**2 + 1))
        self._poses = table.poses[order]
        self._features = self._compared(table.parameters[order])

    def _detector(self, parameters: Array) -> Array:
        """Return the number of the detector at the peak, row-major."""
        column, row = np.rint(parameters[..., 1:3] + (self._side - 1) / 2).T
        return row * self._side + column

    def _compared(self, parameters: Array) -> Array:
        """Return both skewnesses and the spectral angle to (peak, 0, 0, 0, 0), an aligned array."""
        units = unit_vectors(parameters)
        angles = np.arctan2(np.linalg.norm(units[..., 1:], axis=-1), units[..., 0])
        return np.stack([parameters[..., 3], parameters[..., 4], angles], axis=-1)

    def pose(self, image: ArrayLike) -> Array:
        """Look up the pose of an image of counts, m and rad, ``(5,)``: a row of the table.

        NoPose for an image of another shape, without light, or whose peak no pose of the table has.
        """
        image = _lit(image, self._side)
        parameters = key_parameters(image, self._full_scale_counts, "detector")
        detector = int(self._detector(parameters))
        candidates = slice(*self._starts[detector : detector + 2])
        if candidates.start == candidates.stop:
            row, column = divmod(detector, self._side)
            raise NoPose(f"no match: no pose of the table peaks in row {row}, column {column}")
        differences = np.abs(self._features[candidates] - self._compared(parameters))
        return np.array(self._poses[candidates][np.argmin(differences @ self._weights)])


@np.errstate(under="ignore")
def image_moments(images: ArrayLike, spacing_m: float) -> Array:
    """Compute ``M_pq = sum (y - y0)^(p-1) (z - z0)^(q-1) I / sum I``, p and q from 1 to 3.

    M_pq is at ``[..., p - 1, q - 1]``, m^(p + q - 2), of lit images ``(..., side, side)``; y and z
    run to port and up, y0 and z0 are the peak's, by a parabola through its neighbours.
    """
    images = np.asarray(images, dtype=float)
    side = images.shape[-1]
    offsets = spacing_m * ((side - 1) / 2 - np.arange(side))
    peak = -key_parameters(images, 1.0, "subdetector")[..., 1:3] * spacing_m
    off = (offsets - peak[..., None])[..., None, :] ** np.arange(3)[:, None]
    along_y, along_z = off[..., 0, :, :], off[..., 1, :, :]
    total = images.sum(axis=(-2, -1))[..., None, None]
    # Rows of the image run along z, columns along y.
    return (along_y @ np.swapaxes(images, -1, -2) @ np.swapaxes(along_z, -1, -2)) / total


def measured(images: ArrayLike, spacing_m: float) -> Array:
    """Measure what the moments method takes a pose from, a number a component, ``(..., 5)``.

    The logarithm of the brightest reading, the first moments about the peak along y and z, m, and
    M32 / M33 and M23 / M33, 1/m, nan where M33 is 0.
    """
    m = image_moments(images, spacing_m)
    m33 = np.where(m[..., 2, 2] > 0, m[..., 2, 2], np.nan)
    with np.errstate(divide="ignore"):
        peak = np.log(np.asarray(images, dtype=float).max(axis=(-2, -1)))
    angles = m[..., 2, 1] / m33, m[..., 1, 2] / m33
    return np.stack([peak, m[..., 1, 0], m[..., 0, 1], *angles], axis=-1)


@dataclass(frozen=True)
class MomentCalibration:
    """The moments method, calibrated: a line ``a + b value`` through each of `measured`."""

    spacing_m: float
    side: int
    # a and b of x, y, z, m, pitch, yaw, rad; x is minus the paper's range -log(peak / a1) / b1.
    lines: Array

    def poses(self, images: ArrayLike) -> Array:
        """Return the poses of single images, m and rad, shape ``(..., 5)``; nan without one."""
        with np.errstate(invalid="ignore"):
            return self.lines[:, 0] + self.lines[:, 1] * measured(images, self.spacing_m)

    def pose(self, image: ArrayLike) -> Array:
        """Estimate the pose of an image as `LookUp.pose`; NoPose without light or a pattern."""
        pose = self.poses(_lit(image, self.side))
        if not np.isfinite(pose).all():
            raise NoPose("no pattern: M33 is 0, so it has no angles; is one detector alone lit?")
        if np.abs(pose[PITCH:]).max() >= np.pi / 2:
            pitch, yaw = np.degrees(pose[PITCH:])
            raise NoPose(f"no heading: the moments say pitch {pitch:.0f} and yaw {yaw:.0f} deg")
        return pose


def calibrate(
    model: ForwardModel, rng: np.random.Generator, samples: int = SAMPLES
) -> MomentCalibration:
    """Calibrate the moments method at the paper's poses, by the mean of `samples` images at each.

    The paper does not say where its array was turned: here on the beam's axis, at each range.
    """
    spacing_m, side = model.array.spacing_m, model.array.side
    grid = np.stack(np.meshgrid(-RANGES_M, ACROSS_M, DOWN_M, indexing="ij"), axis=-1)
    places = np.pad(grid.reshape(-1, 3), ((0, 0), (0, 2)))
    ranges, angles = map(np.ravel, np.meshgrid(RANGES_M, TURNS_RAD))
    pitched, yawed = np.zeros((2, len(ranges), 5))
    pitched[:, X], pitched[:, PITCH] = yawed[:, X], yawed[:, YAW] = -ranges, angles
    lines = []
    for poses, dofs in ((places, (X, Y, Z)), (pitched, (PITCH,)), (yawed, (YAW,))):
        light, images = model.light(poses), np.zeros((len(poses), side, side))
        for _ in range(samples):
            images += model.read(light, rng)
        values = measured(images / samples, spacing_m)
        lines += [np.polyfit(values[:, dof], poses[:, dof], 1)[::-1] for dof in dofs]
    return MomentCalibration(spacing_m, side, np.array(lines))


def dead_reckoned(poses: Array) -> Array:
    """Carry y and z of the first frame, ``(..., frames, 5)``, along the heading of each later one.

    With ``R = dx / (cos pitch cos yaw)`` and the angles of the later frame, ``dy = R cos pitch sin
    yaw`` and ``dz = -R sin pitch``.
    """
    x, pitch, yaw = (poses[..., dof] for dof in (X, PITCH, YAW))
    advance = np.diff(x) / (np.cos(pitch) * np.cos(yaw))[..., 1:]
    reckoned = poses.copy()
    for dof, share in {Y: np.cos(pitch) * np.sin(yaw), Z: -np.sin(pitch)}.items():
        moved = np.cumsum(advance * share[..., 1:], axis=-1)
        reckoned[..., 1:, dof] = poses[..., :1, dof] + moved
    return reckoned
