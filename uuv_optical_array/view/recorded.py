"""The page on a recorded bag: its images estimated again, and a time line through them."""

import time
from bisect import bisect_right
from collections.abc import Callable, Iterator
from queue import Empty, SimpleQueue

import numpy as np

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.recording.images import Recording
from uuv_optical_array.recording.replay import replay
from uuv_optical_array.view.page import Page
from uuv_optical_array.view.sight import WINDOW_S, Sight, sight_of

LONGEST_WAIT_S = 1.0  # from one image to the next, however long the gap of the recording is


def sights_of(recording: Recording, estimator: Estimator) -> Iterator[Sight]:
    """Yield what the page shows of each image, tracked; the recording's poses are the truth.

    The state is the one that was published in the run, whatever the images give now.
    """
    images, stamps_ns, commands = recording.images, recording.stamps_ns, recording.commands
    answers = replay(images, stamps_ns, estimator, TrackerSettings(), commands=commands)
    begin_s = float(stamps_ns[0]) * 1e-9
    states = [state._replace(since_s=state.since_s - begin_s) for state in recording.states]
    begins = [state.since_s for state in states]
    for answer, image, true in zip(answers, images, recording.poses, strict=True):
        seconds = float(answer.stamp_ns - stamps_ns[0]) * 1e-9
        told = bisect_right(begins, seconds)
        state = states[told - 1] if told else None
        known = None if np.isnan(true).any() else true
        yield sight_of(answer, seconds, image, known, state=state)


class Player:
    """The place in a recording of times from 0 on: time moves it on, and the time line anywhere."""

    def __init__(self, times_s: list[float], clock: Callable[[], float] = time.monotonic) -> None:
        self._times, self._clock = times_s, clock
        self._chosen: SimpleQueue[tuple[int, bool]] = SimpleQueue()
        self._at, self._runs, self._due = 0, True, clock()
        self.choose(0.0, True)

    def choose(self, t_s: float, runs: bool) -> None:
        """Go to a time, s, and let time run on or not; from any thread."""
        self._chosen.put((max(bisect_right(self._times, t_s + 1e-6) - 1, 0), runs))

    def next(self) -> tuple[int, bool]:
        """Wait for the next image to show; return its number, and whether `choose` named it."""
        wait_s = None  # for a choice
        if self._runs and self._at < len(self._times) - 1:
            gap_s, now = self._times[self._at + 1] - self._times[self._at], self._clock()
            self._due = max(self._due + min(gap_s, LONGEST_WAIT_S), now)
            wait_s = self._due - now
        try:
            self._at, self._runs = self._chosen.get(timeout=wait_s)
        except Empty:
            self._at += 1
            return self._at, False
        while not self._chosen.empty():  # the last counts
            self._at, self._runs = self._chosen.get()
        self._due = self._clock()
        return self._at, True


def play(
    page: Page, estimator: Estimator, recording: Recording, goes_on: Callable[[float], bool]
) -> None:
    """Show a recording on a page, with a time line, while it goes on after the time shown, s."""
    sights = list(sights_of(recording, estimator))
    times = [sight.t_s for sight in sights]
    player = Player(times)
    move = page.add_time_line(times[-1], player.choose)
    t_s = 0.0
    while goes_on(t_s):
        at, chosen = player.next()
        t_s = times[at]
        if chosen:
            page.remember(sights[bisect_right(times, t_s - WINDOW_S) : at])
        page.show(sights[at])
        move(t_s)
