"""The state of a track: pose, rate, and the slowly varying states behind them.

The rate is what the commands do not explain. Slowly varying are the scene's unknown constants, gain
errors of the detectors where they are few enough to be learnt, and the errors by which shades move
a pose, in standard deviations.
"""

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.tracking.root_filter import Gaussian, triangular
from uuv_optical_array.estimation.tracking.track import POSE, RATE
from uuv_optical_array.estimation.unknowns.constants import Constants, drift

SLOW = RATE.stop  # where the slowly varying states begin
# Gain errors of more detectors are not learnt; they are consider parameters of the readings.
MOST_LEARNT = 49


class StateSpace:
    """Which entry of the state is what, and how the slowly varying ones drift.

    - constants: what is not known of the scene.
    - hold_s: time in which constants and gains drift to new values, s.
    - constants, gains, shades: entries of the state.
    - size: of the state.
    - consider: how many gain errors are consider parameters.
    - linear: pose and constants.
    """

    def __init__(self, constants: Constants, hold_s: float) -> None:
        c, gains = constants, constants.detectors if constants.gain_std > 0 else 0
        learnt = gains if gains <= MOST_LEARNT else 0
        shades = 5 if c.unclear_lasts_s > 0 else 0
        self.consider = gains - learnt
        self.constants = slice(SLOW, SLOW + len(c.names))
        self.gains = slice(self.constants.stop, self.constants.stop + learnt)
        self.shades = slice(self.gains.stop, self.gains.stop + shades)
        self.size = self.shades.stop
        self.linear = np.r_[POSE, self.constants]
        # Of the prior; 0 for pose and rate.
        self._stds = np.concatenate(
            [np.zeros(SLOW), c.stds, np.full(learnt, c.gain_std), np.ones(shades)]
        )
        self._constants_hold_s = hold_s
        self._hold_s = np.full(self.size, hold_s)
        self._hold_s[:SLOW], self._hold_s[self.shades] = np.inf, c.unclear_lasts_s

    def prior(self) -> Gaussian:
        """Return the slowly varying states before any frame; pose and rate are 0."""
        zeros = np.zeros((self.size, self.consider))
        return Gaussian(np.zeros(self.size), np.diag(self._stds), zeros)

    def drifted(self, state: Gaussian, step_s: float) -> Gaussian:
        """Let the slowly varying states drift for a time, s."""
        decay, consider_decay = drift(self._hold_s, step_s), drift(self._constants_hold_s, step_s)
        noise = np.diag(np.sqrt(1 - decay**2) * self._stds)[:, SLOW:]
        root, consider = decay[:, None] * state.root, decay[:, None] * state.consider
        # The consider parameters drift, too: errors by their old values are errors of its own.
        old = np.sqrt(1 - consider_decay**2) * consider
        root = np.concatenate([root, noise, old], axis=1)
        return Gaussian(decay * state.mean, root, consider_decay * consider)

    def constants_after(self, state: Gaussian, step_s: float) -> tuple[Array, Array]:
        """Return mean and covariance of the constants after a time, s."""
        decay, of = drift(self._constants_hold_s, step_s), self.constants
        root = state.full_root[of]
        noise = np.diag((1 - decay**2) * self._stds[of] ** 2)
        return decay * state.mean[of], decay**2 * (root @ root.T) + noise

    def slow_after(self, state: Gaussian, step_s: float) -> Gaussian:
        """Return the slowly varying states after a time, s; pose and rate are 0."""
        mean, root, consider = self.drifted(state, step_s)
        root = triangular(root)
        mean[:SLOW], root[:SLOW], consider[:SLOW] = 0.0, 0.0, 0.0
        return Gaussian(mean, root, consider)
