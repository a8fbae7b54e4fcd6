"""Coordinates of pose and constants together in which many images stay linear.

Range, the lamp's power, the water and the beam's width all read as brightness. What an image knows
is the brightness, so of range and constants together it leaves a valley that is narrow and bent.
In the fit's coordinates of the pose (`least_squares.coordinates`), with the constants taken into
the attenuation, ``ln r + K r / 2 + eta^2 / (4 sigma^2) - ln(P) / 2``, the valley is straight:
an image fixes this number and next to nothing else of the constants. A filter that corrects pose
and constants in metres takes the bend for knowledge, a little in every frame, and becomes sure of
a wrong scene.
"""

import math
from collections.abc import Sequence

import numpy as np

from uuv_optical_array.core.geometry import PITCH, YAW, Array, rotation, wrapped
from uuv_optical_array.estimation.least_squares.coordinates import (
    AZIMUTH,
    LOG_ATTENUATION,
    Frame,
    beam_loss,
    from_pose,
    to_lamp,
    write_slopes,
)
from uuv_optical_array.forward.scene import ATTENUATION, BEAM_SIGMA, POWER

LEAST_WIDTH = 0.1  # of the beam, of that in the scene: below it no constant makes it


class AsTheyAre:
    """Pose and constants themselves as coordinates, for light that is linear in them."""

    def of(self, at: Array) -> Array:
        """Return the coordinates of pose and constants, shape ``(5 + q,)`` both."""
        return at.copy()

    def place(self, coordinates: Array) -> tuple[Array, Array]:
        """Return pose and constants at coordinates, and their slopes by them.

        Returns
        -------
        at
            Shape ``(5 + q,)``.
        slopes
            Shape ``(5 + q, 5 + q)``.
        """
        return coordinates.copy(), np.eye(len(coordinates))

    def difference(self, coordinates: Array, others: Array) -> Array:
        """Return by how much coordinates differ, angles in [-pi, pi], shape ``(5 + q,)``."""
        return wrapped(coordinates - others, YAW)


class JointCoordinates(AsTheyAre):
    """From pose and constants to coordinates and back; the constants stay as they are.

    Parameters
    ----------
    frame
        Of the scene, as `coordinates.frame_of` returns it.
    names
        Dotted names of the constants; those that do not change the attenuation are left alone.
    """

    def __init__(self, frame: Frame, names: Sequence[str]) -> None:
        self._frame = frame
        places = {name: 5 + i for i, name in enumerate(names)}
        self._power, self._water, self._width = (
            places.get(name) for name in (POWER, ATTENUATION, BEAM_SIGMA)
        )

    def _frame_with(self, at: Array) -> Frame:
        frame = self._frame
        if self._water is not None:
            frame = frame._replace(k_per_m=max(frame.k_per_m + float(at[self._water]), 0.0))
        if self._width is not None:
            width = frame.beam_sigma_rad + math.radians(at[self._width])
            least = LEAST_WIDTH * frame.beam_sigma_rad
            frame = frame._replace(beam_sigma_rad=max(width, least))
        return frame

    def of(self, at: Array) -> Array:
        """Return the coordinates of pose and constants."""
        coordinates = at.copy()
        coordinates[:5] = from_pose(self._frame_with(at), at[:5], 0.0)
        if self._power is not None:
            coordinates[LOG_ATTENUATION] -= 0.5 * at[self._power]
        return coordinates

    def place(self, coordinates: Array) -> tuple[Array, Array]:
        """Return pose and constants at coordinates, and their slopes by them."""
        frame, own = self._frame_with(coordinates), coordinates[:5].copy()
        if self._power is not None:
            own[LOG_ATTENUATION] += 0.5 * coordinates[self._power]
        lamp, pose, _ = to_lamp(frame, own, 0.0)
        slopes = np.eye(len(coordinates))
        by_pose = np.zeros((5, 5))
        write_slopes(frame, own, 0.0, lamp, np.zeros((6, 5)), by_pose)
        slopes[:5, :5] = by_pose
        # Where a constant grows and the brightness stays, the range gives way.
        sight = np.subtract(lamp[:3], frame[:3])
        range_m = math.sqrt(sight @ sight)
        gives_way = -by_pose[:, LOG_ATTENUATION]
        if self._power is not None:
            slopes[:5, self._power] = -0.5 * gives_way
        if self._water is not None:
            slopes[:5, self._water] = 0.5 * range_m * gives_way
        if self._width is not None:
            ahead, _, _ = rotation(own[PITCH], own[YAW], 0.0)
            loss, _ = beam_loss(frame, sight / range_m, ahead)
            by_width = math.radians(-2 * loss / frame.beam_sigma_rad)
            slopes[:5, self._width] = by_width * gives_way
        at = coordinates.copy()
        at[:5] = pose
        return at, slopes

    def difference(self, coordinates: Array, others: Array) -> Array:
        """Return by how much coordinates differ."""
        return wrapped(super().difference(coordinates, others), AZIMUTH)
