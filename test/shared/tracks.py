"""Frames, and what it takes to track them."""

import dataclasses
import math

import numpy as np
from scipy.linalg import block_diag, expm
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import Outlier

START_NS = 1_700_000_000_123_456_789  # a wall clock: float64 seconds would lose 100 ns
TENTH_NS = 100_000_000
STATION = np.array([-6.0, 0.2, -0.1, 0.05, -0.02])
STD = np.array([0.3, 0.2, 0.2, 0.1, 0.1])
NOISE = np.diag(STD**2)


def correlated(std):
    """Return a covariance in which errors of y and yaw, of z and pitch are nearly proportional."""
    alike = np.eye(5)
    alike[1, 4] = alike[4, 1] = -0.97
    alike[2, 3] = alike[3, 2] = 0.97
    return alike * np.outer(std, std)


CORRELATED = correlated(STD)
OPEN = TrackerSettings(gate_probability=1.0, common_share=0.0)
GATE = math.sqrt(chi2.ppf(TrackerSettings().gate_probability, 5))


def van_loan(step_s, rate_walk):
    """Return transition and noise covariance of one step, by Van Loan's matrix exponential.

    The walk is the covariance of what the rate gathers in 1 s.
    """
    drift = np.eye(10, k=5)
    diffusion = np.zeros((10, 10))
    diffusion[5:, 5:] = rate_walk
    both = expm(step_s * np.block([[-drift, diffusion], [np.zeros((10, 10)), drift.T]]))
    transition = both[10:, 10:].T
    return transition, transition @ both[:10, 10:]


def motion(step_s, options):
    """Return transition and noise covariance of one step with the settings' own motion."""
    walk = np.repeat(
        [options.velocity_walk_m_per_s, math.radians(options.turn_walk_deg_per_s)], [3, 2]
    )
    return van_loan(step_s, np.diag(walk**2))


def turned(pose, twist):
    """Return a twist in the follower's frame as the rate of its pose, by SciPy's rotations."""
    attitude = Rotation.from_euler("ZYX", [pose[4], pose[3], 0.0])
    return np.array([*attitude.apply(twist[:3]), *twist[3:]])


def swung(pose, walk):
    """Return the covariance of a pose's rate by that of the rate of its leader alone."""
    slope = np.eye(5)
    for row in (1, 2):  # a turn of the leader about its axis, by which the pose turns the other way
        slope[:3, 2 + row] = -np.cross(-np.eye(3)[row], pose[:3])
    return slope @ walk @ slope.T


class Textbook:
    """The filter in covariance form, as textbooks have it, for frames in order.

    Commands are pairs of stamp and twist in order; each holds from its stamp to the next.
    """

    def __init__(self, first, start, rate_walk, commands):
        self.stamp, pose, noise = first
        self.mean = np.concatenate([pose, np.zeros(5)])
        self.covariance = block_diag(noise, start)
        self.rate_walk, self.commands = rate_walk, commands

    def take(self, stamp, pose, noise):
        """Move to a later frame and correct by it."""
        walk = swung(self.mean, self.rate_walk)
        transition, walk = van_loan((stamp - self.stamp) * 1e-9, walk)
        mean = transition @ self.mean
        ends = [later for later, _ in self.commands[1:]] + [math.inf]
        for (since, twist), until in zip(self.commands, ends, strict=True):
            held_s = (min(until, stamp) - max(since, self.stamp)) * 1e-9
            if held_s > 0:
                mean[:5] += turned(self.mean, twist) * held_s
        covariance = transition @ self.covariance @ transition.T + walk
        gain = covariance[:, :5] @ np.linalg.inv(covariance[:5, :5] + noise)
        self.stamp, self.mean = stamp, mean + gain @ (pose - mean[:5])
        self.covariance = covariance - gain @ covariance[:5]

    def rate(self):
        """Return the whole rate of the pose, the command that holds included."""
        held = [twist for since, twist in self.commands if since <= self.stamp]
        return self.mean[5:] + turned(self.mean, held[-1])


def whitened(covariance, matrix):
    return np.linalg.solve(np.linalg.cholesky(covariance), matrix)


def scattered(seed, count=12):
    """Return stamps at uneven steps, poses, and a full covariance of its own for each."""
    rng = np.random.default_rng(seed)
    stamps = START_NS + np.cumsum(rng.integers(20_000_000, 400_000_000, count))
    roots = STD[:, None] * (np.eye(5) + 0.5 * rng.standard_normal((count, 5, 5)))
    poses = STATION + (roots @ rng.standard_normal((count, 5, 1)))[..., 0]
    return stamps.tolist(), poses, roots @ np.swapaxes(roots, 1, 2)


def fed(tracker, *frames):
    """Update with every frame and return the last track."""
    track = None
    for stamp, pose, covariance in frames:
        track = tracker.update(stamp, pose, covariance)
    return track


def answer(tracker, frame):
    """Return the track, or why there is none."""
    try:
        return tracker.update(*frame)
    except Outlier as reason:
        return str(reason)


def assert_same_state(tracker, other, stamp):
    """Compare the answers to three frames that follow, in which the states show."""
    for step in (1, 2, 3):
        frame = stamp + step, STATION, NOISE
        answers = answer(tracker, frame), answer(other, frame)
        if isinstance(answers[0], str):
            assert answers[0] == answers[1]
        else:
            assert_same(*answers)


def moved(dof, by):
    pose = np.array(STATION)
    pose[dof] += by
    return pose


def steady(count, pose=STATION, start_ns=START_NS):
    return [(start_ns + k * TENTH_NS, pose, NOISE) for k in range(count)]


def assert_same(track, other):
    for field in dataclasses.fields(track):
        np.testing.assert_array_equal(getattr(track, field.name), getattr(other, field.name))
