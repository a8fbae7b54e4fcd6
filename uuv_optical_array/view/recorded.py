"""The page on a recorded bag: its images estimated anew, and a time line through them."""

import threading
import time
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.pipeline import Answer
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.recording.images import Recording
from uuv_optical_array.recording.replay import replay
from uuv_optical_array.view.page import Page
from uuv_optical_array.view.sight import WINDOW_S, Sight

LONGEST_WAIT_S = 1.0  # from one image to the next, whatever gap the recording has


def sights_of(
    recording: Recording,
    estimator: Estimator,
    progress: Callable[[Iterable[Answer]], Iterable[Answer]] = iter,
) -> Iterator[Sight]:
    """Yield what the page shows of each image, tracked, in their order.

    Parameters
    ----------
    recording
        Its poses, where it has any, are the truth.
    estimator
        Of the scene of the array.
    progress
        Wraps the frames, to show how far it is.
    """
    images, stamps_ns, commands = recording.images, recording.stamps_ns, recording.commands
    frames = replay(images, stamps_ns, estimator, TrackerSettings(), commands=commands)
    for i, frame in enumerate(progress(frames)):
        true = recording.poses[i]
        track = frame.track
        yield Sight(
            float(frame.stamp_ns - recording.stamps_ns[0]) * 1e-9,
            recording.images[i],
            None if np.isnan(true).any() else true,
            None if track is None else track.pose,
            None if track is None else track.covariance,
            frame.reason,
        )


class Player:
    """Where a recording is, as the time line and the passing time have it.

    Parameters
    ----------
    times_s
        Of the images, ascending from 0, s.
    clock
        Returns the time that passes, s.
    """

    def __init__(self, times_s: list[float], clock: Callable[[], float] = time.monotonic) -> None:
        self._times, self._clock = times_s, clock
        self._lock = threading.Condition()
        self._at, self._runs, self._moved = 0, True, True
        self._due = self._clock()

    def choose(self, t_s: float, runs: bool) -> None:
        """Go to a time, s, and let it run on or not; from any thread."""
        with self._lock:
            self._at = max(bisect_right(self._times, t_s + 1e-6) - 1, 0)
            self._runs, self._moved = runs, True
            self._lock.notify()

    def next(self) -> tuple[int, bool]:
        """Wait until another image is to be shown; return which, and whether it was jumped to."""
        with self._lock:
            if not self._moved:
                self._wait()
            jumped, self._moved = self._moved, False
            if not jumped:
                self._at += 1
            return self._at, jumped

    def _wait(self) -> None:
        """Wait for the next image's time, or until a time is chosen."""
        while not self._moved:
            last = self._at >= len(self._times) - 1
            if self._runs and not last:
                gap_s = self._times[self._at + 1] - self._times[self._at]
                self._due = max(self._due + min(gap_s, LONGEST_WAIT_S), self._clock())
                while not self._moved and (left_s := self._due - self._clock()) > 0:
                    self._lock.wait(left_s)
                return
            self._lock.wait(1.0)  # Ctrl-C is served between two waits
            self._due = self._clock()


def play(
    page: Page,
    estimator: Estimator,
    recording: Recording,
    goes_on: Callable[[float], bool] = lambda t_s: True,
    progress: Callable[[Iterable[Answer]], Iterable[Answer]] = iter,
) -> None:
    """Show a recording on a page.

    Parameters
    ----------
    page
        Gets the time line and is drawn on.
    estimator, recording, progress
        As of `sights_of`.
    goes_on
        Asked with the time that is shown, s, before the next.
    """
    sights = list(sights_of(recording, estimator, progress))
    times = [sight.t_s for sight in sights]
    player = Player(times)
    move = page.add_time_line(times[-1], player.choose)
    t_s = 0.0
    while goes_on(t_s):
        at, jumped = player.next()
        t_s = times[at]
        if jumped:
            first = bisect_right(times, t_s - WINDOW_S)
            page.remember(sights[first:at])
        page.show(sights[at])
        move(t_s)
