"""What changed at once is told by its evidence, as the motion's states give it step by step."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.belief import BiasSpace
from uuv_optical_array.estimation.tracking.change import FIRST_POSE_STD, SPAN_NS, Changes
from uuv_optical_array.estimation.tracking.motion import RATE_STD, walk_noise
from uuv_optical_array.estimation.unknowns.constants import Constants

SIDE, GAIN_STD, STDS = 3, 0.01, np.array([0.1, 5.0])
CONSTANTS = Constants(("lamp.power", "ambient.level_counts"), tuple(STDS), GAIN_STD, SIDE**2)
WALK = np.array([0.1, 0.1, 0.1, 0.03, 0.03])
STD, ODDS = 10.0, np.array([1.0, 0.3, 0.02])
COUNT = SIDE**2
# The power, the ambient level, and the second detector.
DIRECTIONS = np.eye(2 + COUNT)[:, [0, 1, 3]]


class Sea:
    """Frames that are linear in pose and biases, seen along a way with a change in it."""

    def __init__(self, rng, times_s, began, change):
        """Let biases change by `change`, ``(learnt,)``, from the frame `began` on."""
        count = len(times_s)
        self.times_s = times_s
        self.stamps_ns = [10**18 + round(t * 1e9) for t in times_s]
        self.light = rng.uniform(100, 900, (count, COUNT))
        self.by_pose = 300 * rng.standard_normal((count, COUNT, 5))
        ambient = STDS[1] * np.ones((count, COUNT, 1))
        gains = GAIN_STD * self.light[..., None] * np.eye(COUNT)
        self.by_biases = np.concatenate([STDS[0] * self.light[..., None], ambient, gains], axis=2)
        self.expected = np.array([-6.0, 0, 0, 0, 3.1]) + np.outer(times_s, [0.1, 0.2, 0, 0, 0.05])
        self.ways = np.cumsum(rng.uniform(-0.1, 0.1, (count, 5)), axis=0)
        biases = rng.standard_normal(2 + COUNT) + np.outer(np.arange(count) >= began, change)
        off = self.by_pose @ np.array([0.3, -0.2, 0.1, 0.02, 0.03])
        self.y = off + np.einsum("tnk,tk->tn", self.by_biases, biases)
        self.y += rng.standard_normal(self.y.shape)

    def told(self):
        changes, before = Changes(BiasSpace(CONSTANTS, 3600.0), WALK), np.zeros(5)
        for k, stamp_ns in enumerate(self.stamps_ns):

            def readings(place, k=k):
                # Linear in the pose and in constants; y is of the expected way.
                slopes = np.concatenate([self.by_pose[k], self.by_biases[k, :, :2] / STDS], axis=1)
                off = place - [*self.expected[k], 0, 0] - [*self.ways[k], 0, 0]
                off[:5] += self.ways[0]
                residuals = self.y[k] - slopes @ off
                return LinearisedReadings(place, residuals, slopes, self.light[k], np.ones(COUNT))

            way = self.ways[k] - before
            before = self.ways[k]
            pose = self.expected[k] + self.ways[k] - self.ways[0]
            pose[4] = (pose[4] + np.pi) % (2 * np.pi) - np.pi
            changes.add(stamp_ns, way, pose, readings)
        return changes.likeliest(DIRECTIONS, STD, ODDS)

    def covariance(self):
        """Return the covariance of all readings without a change, state by state."""
        count, state = len(self.times_s), np.diag(np.square([*FIRST_POSE_STD, *RATE_STD]))
        blocks, cross = {}, {}
        for k in range(count):
            if k:
                step_s = self.times_s[k] - self.times_s[k - 1]
                onward = np.eye(10) + step_s * np.eye(10, k=5)
                noise = walk_noise(np.diag(np.square(WALK)), step_s)
                state = onward @ state @ onward.T + noise
                cross = {i: onward @ each for i, each in cross.items()}
            cross[k] = state
            for i, each in cross.items():
                blocks[k, i] = self.by_pose[k] @ each[:5, :5] @ self.by_pose[i].T
        motion = np.block(
            [
                [blocks[max(i, k), min(i, k)].T if k > i else blocks[i, k] for k in range(count)]
                for i in range(count)
            ]
        )
        biased = np.concatenate(self.by_biases)
        return motion + biased @ biased.T + np.eye(count * COUNT)


@pytest.mark.parametrize(
    ("seed", "error", "change"), [(1, 0, -1.0), (2, 1, 2.0), (3, 2, 8.0), (4, 0, 0.0)]
)
def test_the_likeliest_change_is_that_of_gaussian_readings_with_its_size(seed, error, change):
    times_s = np.array([0.0, 0.1, 0.2, 0.35, 0.75, 0.85, 0.95, 1.05])
    sea = Sea(np.random.default_rng(seed), times_s, 4, change * DIRECTIONS[:, error])
    plain, y = sea.covariance(), sea.y.ravel()
    unchanged, found = multivariate_normal.logpdf(y, cov=plain), {}
    for k in range(1, len(times_s)):
        for i, odds in enumerate(ODDS):
            slopes = (sea.by_biases @ DIRECTIONS[:, i]) * (np.arange(len(times_s)) >= k)[:, None]
            wider = plain + STD**2 * np.outer(slopes, slopes)
            evidence = multivariate_normal.logpdf(y, cov=wider) - unchanged + np.log(odds)
            found[evidence] = i, STD**2 * slopes.ravel() @ np.linalg.solve(wider, y)
    told = sea.told()
    likeliest, size = found[max(found)]
    assert told.error == likeliest
    assert change == 0 or likeliest == error
    # Rounding needs 0.03 mm of each pose, which moves readings by a hundredth of their noise.
    assert told.evidence == pytest.approx(max(found), rel=2e-3, abs=2e-3)
    assert told.size == pytest.approx(size, rel=2e-3)


def test_after_a_gap_or_a_clock_set_back_frames_are_the_first():
    def readings(place):
        raise AssertionError("a single frame tells of no change")

    for later_ns in (SPAN_NS, -1):
        changes = Changes(BiasSpace(CONSTANTS, 3600.0), WALK)
        for stamp_ns in (10**18, 10**18 + 10**8, 10**18 + 2 * 10**8):
            changes.add(stamp_ns, np.zeros(5), np.zeros(5), readings)
        changes.add(stamp_ns + later_ns, np.zeros(5), np.zeros(5), readings)
        assert changes.likeliest(DIRECTIONS, STD, ODDS) is None
