"""The state of a track: the pose, its rate, and behind them all that lasts.

The rate is what the commands do not say of it. What lasts are the scene's unknown constants, gain
errors of the detectors where they are few enough to be learnt, and what shades do to a pose, in
standard deviations.
"""

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.tracking.filter.root_filter import Belief, triangular
from uuv_optical_array.estimation.tracking.track import POSE, RATE
from uuv_optical_array.estimation.unknowns.constants import Constants, drift

MOVING = RATE.stop
# Gain errors of more detectors are not learnt, but spoil their readings for ever.
MOST_LEARNT = 49


class StateSpace:
    """Which entry of the state is what, and how what lasts drifts.

    Parameters
    ----------
    constants
        What is not known of the scene.

    Attributes
    ----------
    constants, gains, shades : slice
        Entries of the state.
    size : int
        Of the state.
    spoilt : int
        How many gain errors are none of its entries.
    linear : ndarray of int
        Pose and constants.
    """

    def __init__(self, constants: Constants) -> None:
        c, spoil = constants, constants.detectors if constants.gain_std > 0 else 0
        learnt = spoil if spoil <= MOST_LEARNT else 0
        shades = 5 if c.unclear_lasts_s > 0 else 0
        self.spoilt = spoil - learnt
        self.constants = slice(MOVING, MOVING + len(c.names))
        self.gains = slice(self.constants.stop, self.constants.stop + learnt)
        self.shades = slice(self.gains.stop, self.gains.stop + shades)
        self.size = self.shades.stop
        self.linear = np.r_[POSE, self.constants]
        # Before any frame, and of what moves 0.
        self._stds = np.concatenate(
            [np.zeros(MOVING), c.stds, np.full(learnt, c.gain_std), np.ones(shades)]
        )
        self._unclear_lasts_s = c.unclear_lasts_s

    def hold(self, constants_hold_s: float) -> None:
        """Let constants and gains drift to new values in a time, s."""
        self._constants_hold_s = constants_hold_s
        self._hold_s = np.full(self.size, constants_hold_s)
        self._hold_s[:MOVING], self._hold_s[self.shades] = np.inf, self._unclear_lasts_s

    def unknown(self) -> Belief:
        """Return the belief in what lasts before any frame, and in nothing else."""
        return Belief(np.zeros(self.size), np.diag(self._stds), np.zeros((self.size, self.spoilt)))

    def drifted(self, belief: Belief, step_s: float) -> Belief:
        """Let what lasts drift for a time, s."""
        held = drift(self._constants_hold_s, step_s)
        kept = drift(self._hold_s, step_s)
        fresh = np.diag(np.sqrt(1 - kept**2) * self._stds)[:, MOVING:]
        root, shared = kept[:, None] * belief.root, kept[:, None] * belief.shared
        # The numbers that spoil the readings drift, too: what came of the old ones is left behind.
        lost = np.sqrt(1 - held**2)
        root = np.concatenate([root, fresh, lost * shared], axis=1)
        return Belief(kept * belief.mean, root, held * shared)

    def known(self, belief: Belief, step_s: float) -> tuple[Array, Array]:
        """Return mean and covariance of the constants after a time, s."""
        held, of = drift(self._constants_hold_s, step_s), self.constants
        root = belief.whole_root[of]
        fresh = np.diag((1 - held**2) * self._stds[of] ** 2)
        return held * belief.mean[of], held**2 * (root @ root.T) + fresh

    def held(self, belief: Belief, step_s: float) -> Belief:
        """Return a belief after a time, s, in nothing but what lasts."""
        mean, root, shared = self.drifted(belief, step_s)
        root = triangular(root)
        mean[:MOVING], root[:MOVING], shared[:MOVING] = 0.0, 0.0, 0.0
        return Belief(mean, root, shared)
