"""What an image leaves of the pose: an estimate, and how far it can be trusted."""

import math
from dataclasses import dataclass

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.information.linearised import LinearisedReadings


@dataclass(frozen=True)
class Estimate:
    """A pose and how far it can be trusted.

    - pose: ``(x, y, z, pitch, yaw)`` of the follower in ``beacon``, m and rad, shape ``(5,)``.
    - covariance: of `pose`, m^2, m rad and rad^2, shape ``(5, 5)``, positive definite; the roll is
      taken as given.
    - angle_rad: spectral angle to the nearest signature that was looked at, in [0, pi]: of all rows
      of the table, or of those that ``least_squares`` starts from.
    - runner_up_pose: the second choice: the second nearest entry, or the next minimum of the fit;
      ``None`` where every start of the fit led to one.
    - runner_up_angle_rad: spectral angle to the second nearest signature.
    - misfit: probability that a valid image leaves larger residuals, in [0, 1]; nan unless the
      image was fitted.
    - runner_up_misfit: the same of the runner-up.
    - unobservable: degrees of freedom of which the image says next to nothing.
    - readings: the likelihood of the image near its best fit, where it was told what is expected;
      ``None`` where that is far from Gaussian, or something may shade the image.
    - stretch: factor, >= 1, of the covariance and so of the readings' variances, by the residuals.
    - clear: probability that the image is lit as the scene says: by no shade, nor else unevenly.
    - left_out: rows and columns, from 0, of detectors whose readings were left out as faulty: dead,
      stuck, dirty or in a glint.
    - roll: by several lamps, how much more the follower rolls than was given, rad.
    - turn: by several lamps, the covariance of the follower's roll with the pose, and its variance,
      shape ``(6,)``; ``None`` by one, which does not show the roll.
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
    stretch: float = 1.0
    clear: float = 1.0
    left_out: tuple[tuple[int, int], ...] = ()
    roll: float = 0.0
    turn: Array | None = None
    dark_lamp: int | None = None

    @property
    def fault(self) -> str:
        """Which lamp or detectors were left out, in words; empty where none was."""
        if self.dark_lamp is not None:
            return f"dark lamp: lamps[{self.dark_lamp}] is off or hidden"
        places = ", ".join(f"row {row} column {column}" for row, column in self.left_out)
        return f"faulty detector: {places} (from 0, top and port) left out" if places else ""
