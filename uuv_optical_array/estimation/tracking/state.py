"""The state of a track: the pose, its rate, and behind them all that lasts.

The rate is what the commands do not say of it. What lasts are the scene's unknown constants, gain
errors of the detectors where they are few enough to be learnt, and what shades do to a pose, in
standard deviations.
"""

import numpy as np

from uuv_optical_array.estimation.constants import Constants, drift
from uuv_optical_array.estimation.tracking.root_filter import Belief, triangular
from uuv_optical_array.estimation.tracking.track import POSE, RATE

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
    linear : list of int
        Pose and constants.
    """

    def __init__(self, constants: Constants) -> None:
        c, spoil = constants, constants.detectors if constants.gain_std > 0 else 0
        learnt = spoil if spoil <= MOST_LEARNT else 0
        shades = 5 if c.shade_lasts_s > 0 else 0
        self.spoilt = spoil - learnt
        self.constants = slice(MOVING, MOVING + len(c.names))
        self.gains = slice(self.constants.stop, self.constants.stop + learnt)
        self.shades = slice(self.gains.stop, self.gains.stop + shades)
        self.size = self.shades.stop
        self.linear = [*range(*POSE.indices(self.size)), *range(*self.constants.indices(self.size))]
        # Of all that lasts, before any frame.
        self._stds = np.concatenate([c.stds, np.full(learnt, c.gain_std), np.ones(shades)])
        self._shade_lasts_s = c.shade_lasts_s

    def hold(self, constants_hold_s: float) -> None:
        """Let constants and gains drift to new values in a time, s."""
        self._constants_hold_s = constants_hold_s
        shades = self.shades.stop - self.shades.start
        self._hold_s = np.full(len(self._stds), constants_hold_s)
        self._hold_s[len(self._stds) - shades :] = self._shade_lasts_s

    def unknown(self) -> Belief:
        """Return the belief in what lasts before any frame, and in nothing else."""
        root = np.diag(np.concatenate([np.zeros(MOVING), self._stds]))
        return Belief(np.zeros(self.size), root, np.zeros((self.size, self.spoilt)))

    def drifted(self, belief: Belief, step_s: float) -> Belief:
        """Let what lasts drift for a time, s."""
        held = drift(self._constants_hold_s, step_s)
        kept = drift(self._hold_s, step_s)
        mean, root = belief.mean.copy(), belief.root.copy()
        mean[MOVING:] *= kept
        root[MOVING:] *= kept[:, None]
        fresh = np.zeros((self.size, len(kept)))
        fresh[MOVING:] = np.diag(np.sqrt(1 - kept**2) * self._stds)
        shared = belief.shared.copy()
        shared[MOVING:] *= kept[:, None]
        # The numbers that spoil the readings drift, too: what came of the old ones is left behind.
        lost = np.sqrt(1 - held**2)
        return Belief(mean, np.hstack([root, fresh, lost * shared]), held * shared)

    def held(self, belief: Belief, step_s: float) -> Belief:
        """Return a belief after a time, s, in nothing but what lasts."""
        mean, root, shared = self.drifted(belief, step_s)
        root = triangular(root)
        mean[:MOVING], root[:MOVING], shared[:MOVING] = 0.0, 0.0, 0.0
        return Belief(mean, root, shared)
