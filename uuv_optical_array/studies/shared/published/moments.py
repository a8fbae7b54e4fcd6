"""The image-moments method of Eren et al. (Sensors 2017, 17(8), 1741).

Range comes from the peak reading, pitch and yaw from ratios of image moments. Position across is
measured in the first frame only and carried forward by dead reckoning: the vehicle is taken to
move along its own heading. Every coefficient comes from a calibration.

The text and the equations of the paper disagree on which ratio is pitch. With y horizontal, M23
is odd in y, so it carries yaw; that is what is done here.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import PITCH, YAW, Array, X, Y, Z
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.forward.model import ForwardModel

# The calibration: 125 positions of an array that looks ahead, and its turns on the beam's axis.
RANGES_M = np.arange(4.5, 9.0, 1.0)
ACROSS_M = np.linspace(-0.6, 0.6, 5)
# The paper's z runs to one side, 0 to 0.8 m; here below the lamp, where its dive ends.
DOWN_M = np.linspace(-0.8, 0.0, 5)
TURNS_RAD = np.radians(np.arange(-15.0, 16.0))
SAMPLES = 200


@dataclass(frozen=True)
class Moments:
    """What the method measures in images of n frames, each of shape ``(n,)``.

    Parameters
    ----------
    peak
        Brightest reading, counts.
    m21, m12
        First moments about the peak along y and z, m.
    yaw_ratio, pitch_ratio
        M23 / M33 and M32 / M33, 1/m; nan where M33 is 0.
    """

    peak: Array
    m21: Array
    m12: Array
    yaw_ratio: Array
    pitch_ratio: Array


def peak_position(images: ArrayLike, spacing_m: float) -> tuple[Array, Array]:
    """Place the peak between detectors, by a parabola through its neighbours.

    Parameters
    ----------
    images
        Readings, counts, shape ``(..., side, side)``.
    spacing_m
        Distance between detectors, m.

    Returns
    -------
    y0, z0 : Array
        Port and up from the array's centre, m, shape ``(...)``.
    """
    parameters = key_parameters(images, 1.0, "subdetector")
    return -parameters[..., 1] * spacing_m, -parameters[..., 2] * spacing_m


@np.errstate(under="ignore")
def image_moments(images: ArrayLike, spacing_m: float) -> Array:
    """Compute ``M_pq = sum (y - y0)^(p-1) (z - z0)^(q-1) I / sum I``, p and q from 1 to 3.

    Parameters
    ----------
    images
        Readings, counts, shape ``(..., side, side)``; each with some light.
    spacing_m
        Distance between detectors, m.

    Returns
    -------
    Array
        M_pq at ``[..., p - 1, q - 1]``, m^(p + q - 2), shape ``(..., 3, 3)``; y and z run to port
        and up, y0 and z0 are `peak_position`.
    """
    images = np.asarray(images, dtype=float)
    side = images.shape[-1]
    offsets = spacing_m * ((side - 1) / 2 - np.arange(side))
    y0, z0 = peak_position(images, spacing_m)
    powers = np.arange(3)[:, None]
    along_y = (offsets - y0[..., None])[..., None, :] ** powers
    along_z = (offsets - z0[..., None])[..., None, :] ** powers
    whole = images.sum(axis=(-2, -1))[..., None, None]
    # Rows of the image run along z, columns along y.
    return (along_y @ np.swapaxes(images, -1, -2) @ np.swapaxes(along_z, -1, -2)) / whole


def measure(images: ArrayLike, spacing_m: float) -> Moments:
    """Measure images, as `image_moments`; for ``(n, side, side)`` of them."""
    images = np.asarray(images, dtype=float)
    moments = image_moments(images, spacing_m)
    spread = moments[..., 2, 2]
    known = np.where(spread > 0, spread, np.nan)
    return Moments(
        images.max(axis=(-2, -1)),
        moments[..., 1, 0],
        moments[..., 0, 1],
        moments[..., 1, 2] / known,
        moments[..., 2, 1] / known,
    )


@dataclass(frozen=True)
class MomentCalibration:
    """The method, calibrated: each pair of coefficients is for ``a + b value``.

    Parameters
    ----------
    spacing_m
        Of the array that was calibrated.
    log_range
        ``range = a + b log(peak)``: the paper's ``-log(peak / a1) / b1``.
    pitch, yaw
        rad, by the ratios.
    y, z
        m, by M21 and M12.
    """

    spacing_m: float
    log_range: tuple[float, float]
    pitch: tuple[float, float]
    yaw: tuple[float, float]
    y: tuple[float, float]
    z: tuple[float, float]

    def poses(self, moments: Moments) -> Array:
        """Return the poses of single images, m and rad, shape ``(..., 5)``; nan without one."""
        poses = np.empty((*moments.peak.shape, 5))
        with np.errstate(divide="ignore", invalid="ignore"):
            poses[..., X] = -_line(self.log_range, np.log(moments.peak))
        poses[..., Y] = _line(self.y, moments.m21)
        poses[..., Z] = _line(self.z, moments.m12)
        poses[..., PITCH] = _line(self.pitch, moments.pitch_ratio)
        poses[..., YAW] = _line(self.yaw, moments.yaw_ratio)
        return poses

    def pose(self, image: ArrayLike) -> Array:
        """Estimate the pose of a single image.

        Parameters
        ----------
        image
            Readings in counts, finite and >= 0, shape ``(side, side)``.

        Returns
        -------
        Array
            ``(x, y, z, pitch, yaw)`` of the follower in ``beacon``, m and rad, shape ``(5,)``.

        Raises
        ------
        NoPose
            For an image without light or without a pattern.
        """
        image = np.asarray(image, dtype=float)
        if image.ndim != 2 or not np.isfinite(image).all():
            raise NoPose("no image: the moments need a square of finite readings")
        if image.max() <= 0:
            raise NoPose(f"no light: the peak is {image.max():g} counts")
        pose = self.poses(measure(image, self.spacing_m))
        if not np.isfinite(pose).all():
            raise NoPose("no pattern: M33 is 0, so it has no angles; is one detector alone lit?")
        if np.abs(pose[PITCH:]).max() >= np.pi / 2:
            pitch, yaw = np.degrees(pose[PITCH:])
            raise NoPose(f"no heading: the moments say pitch {pitch:.0f} and yaw {yaw:.0f} deg")
        return pose


def _line(coefficients: tuple[float, float], values: Array) -> Array:
    return coefficients[0] + coefficients[1] * values


def _fit(values: Array, wanted: Array) -> tuple[float, float]:
    slope, offset = np.polyfit(values, wanted, 1)
    return float(offset), float(slope)


def _mean_images(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
    """Average `SAMPLES` readings at each pose."""
    images = np.zeros((len(poses), model.array.side, model.array.side))
    for _ in range(SAMPLES):
        images += model.expose(poses, rng)
    return images / SAMPLES


def calibrate(model: ForwardModel, rng: np.random.Generator) -> MomentCalibration:
    """Calibrate the method in a scene, at the paper's poses.

    Range and position are fitted over 125 positions of an array that looks ahead; pitch and yaw
    over turns by 1 deg, one at a time, on the beam's axis at each range: the paper does not say
    where its array was turned. Each pose counts by the mean of 200 images.

    Parameters
    ----------
    model
        Forward model of the scene.
    rng
        Source of the noise.

    Returns
    -------
    MomentCalibration
        Least-squares fits.
    """
    grid = np.stack(np.meshgrid(-RANGES_M, ACROSS_M, DOWN_M, indexing="ij"), axis=-1).reshape(-1, 3)
    places = np.concatenate([grid, np.zeros((len(grid), 2))], axis=1)
    spacing_m = model.array.spacing_m
    at_places = measure(_mean_images(model, places, rng), spacing_m)
    ranges, angles = np.meshgrid(RANGES_M, TURNS_RAD)
    turned = {}
    for dof in (PITCH, YAW):
        turns = np.zeros((ranges.size, 5))
        turns[:, X], turns[:, dof] = -ranges.ravel(), angles.ravel()
        turned[dof] = measure(_mean_images(model, turns, rng), spacing_m)
    return MomentCalibration(
        spacing_m,
        _fit(np.log(at_places.peak), -places[:, X]),
        _fit(turned[PITCH].pitch_ratio, angles.ravel()),
        _fit(turned[YAW].yaw_ratio, angles.ravel()),
        _fit(at_places.m21, places[:, Y]),
        _fit(at_places.m12, places[:, Z]),
    )


def dead_reckoned(poses: Array) -> Array:
    """Carry y and z of the first frame forward, along the heading of each later one.

    ``dx = x(k+1) - x(k)``, ``R = dx / (cos pitch cos yaw)``, ``dy = R cos pitch sin yaw`` and
    ``dz = -R sin pitch`` (bow down is positive, and z is up), with the angles of frame k+1.

    Parameters
    ----------
    poses
        What each frame says by itself, m and rad, shape ``(..., frames, 5)``.

    Returns
    -------
    Array
        The same with y and z replaced from the second frame on.
    """
    x, pitch, yaw = (poses[..., dof] for dof in (X, PITCH, YAW))
    advance = np.diff(x) / (np.cos(pitch) * np.cos(yaw))[..., 1:]
    carried = poses.copy()
    steps = {Y: np.cos(pitch) * np.sin(yaw), Z: -np.sin(pitch)}
    for dof, share in steps.items():
        moved = np.cumsum(advance * share[..., 1:], axis=-1)
        carried[..., 1:, dof] = poses[..., :1, dof] + moved
    return carried
