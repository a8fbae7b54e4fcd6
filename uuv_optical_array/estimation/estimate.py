"""What an image leaves of the pose: an estimate, and how far it can be trusted."""

import math
from typing import NamedTuple

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.information.linearised import LinearisedReadings


class Estimate(NamedTuple):
    """A pose and how far it can be trusted.

    - pose: ``(x, y, z, pitch, yaw)`` of the follower in ``beacon``, m and rad, shape ``(5,)``.
    - covariance: of `pose` at the given roll, m and rad, shape ``(5, 5)``, positive definite.
    - angle_rad: spectral angle, in [0, pi], to the nearest row of the table or start of the fit.
    - runner_up_pose: of the second nearest row, or the fit's next minimum; ``None``: there is none.
    - misfit: probability that a valid image leaves larger residuals, in [0, 1]; nan without a fit.
    - runner_up_angle_rad, runner_up_misfit: the same of the runner-up.
    - unobservable: degrees of freedom of which the image says next to nothing.
    - readings: likelihood of the image near its best fit; ``None`` where nothing was expected, or
      something may shade the image.
    - clear: probability that the image is lit as the scene says: by no shade, nor else unevenly.
    - bent: whether `readings` are far from linear over what the image leaves of the pose.
    - believed: probability of each reading that it is of the light, shape ``(n,)``; ``None``: 1.
    - left_out: rows and columns, from 0, of detectors left out: dead, stuck, dirty or in a glint.
    - roll: by several lamps, how much more the follower rolls than was given, rad.
    - turn: covariance of the roll with the pose, and its variance, ``(6,)``; ``None`` by one lamp.
    - dark_lamp: which of several lamps was left out, as it is off or hidden; ``None``: none was.
    """

    pose: Array
    covariance: Array
    angle_rad: float
    runner_up_pose: Array | None
    runner_up_angle_rad: float
    misfit: float = math.nan
    runner_up_misfit: float = math.nan
    unobservable: tuple[str, ...] = ()
    readings: LinearisedReadings | None = None
    clear: float = 1.0
    left_out: tuple[tuple[int, int], ...] = ()
    roll: float = 0.0
    turn: Array | None = None
    dark_lamp: int | None = None
    believed: Array | None = None
    bent: bool = False

    @property
    def fault(self) -> str:
        """Which lamp or detectors were left out, in words; empty where none was."""
        if self.dark_lamp is not None:
            return f"dark lamp: lamps[{self.dark_lamp}] is off or hidden"
        places = ", ".join(f"row {row} column {column}" for row, column in self.left_out)
        return f"faulty detector: {places} (from 0, top and port) left out" if places else ""
