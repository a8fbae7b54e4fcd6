"""How far the work is, on standard error: a bar on a terminal, lines now and then in a file."""

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sized
from types import TracebackType
from typing import Any, TypeVar

from tqdm import tqdm

T = TypeVar("T")
EVERY_S = 10.0  # a line in a file
SETTLED_S = 3.0  # before which nothing is foretold from the rounds alone
PRIOR = 0.1  # of the whole: what a known duration counts beside the rounds that were seen


def left_s(done: float, total: float | None, elapsed_s: float, expected_s: float | None) -> float:
    """Return how long the rest will take, s; nan where that cannot be told yet.

    The mean speed since the start foretells it, so that it changes slowly.

    Parameters
    ----------
    done, total
        Rounds; None where nobody knows how many there will be.
    elapsed_s
        Since the start, s.
    expected_s
        How long the whole was expected to take, s, which counts as a tenth of it done at that
        speed; None where nobody knows.
    """
    if total is None:
        return float("nan")
    if expected_s is not None:
        done_as_if, elapsed_as_if = done + PRIOR * total, elapsed_s + PRIOR * expected_s
        return max(0.0, total - done) * elapsed_as_if / done_as_if if done_as_if else 0.0
    if not done or elapsed_s < SETTLED_S:
        return float("nan")
    return max(0.0, total - done) * elapsed_s / done


def clock(seconds: float) -> str:
    """Return a duration as tqdm writes it; ``?`` for nan."""
    return "?" if seconds != seconds else tqdm.format_interval(seconds)


class _Bar(tqdm):  # type: ignore[misc]  # tqdm has no types
    """A bar on a terminal, its rest foretold by `left_s`."""

    def __init__(self, expected_s: float | None, **options: Any) -> None:
        self.expected_s = expected_s
        super().__init__(**options)

    @property
    def format_dict(self) -> dict[str, Any]:
        """What `bar_format` can name."""
        told = super().format_dict
        rest = left_s(told["n"], told["total"], told["elapsed"], self.expected_s)
        return {**told, "left": clock(rest)}


class _Lines:
    """A line for the first round, then one every ten seconds, and one at the end."""

    def __init__(
        self,
        total: float | None,
        unit: str,
        what: str,
        expected_s: float | None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.total, self.unit, self.what, self.expected_s = total, unit, what, expected_s
        self.n = self.told = 0.0
        self._now_s = now_s
        self._began_s = now_s()
        self._due_s = self._began_s

    def __enter__(self) -> "_Lines":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self.n > self.told:
            self._tell()

    def set_description(self, what: str) -> None:
        """Say what the work is at."""
        self.what = what

    def update(self, n: float = 1) -> None:
        """Count rounds that are done."""
        self.n += n
        if self._now_s() >= self._due_s:
            self._tell()

    def _tell(self) -> None:
        now_s = self._now_s()
        self.told, self._due_s = self.n, now_s + EVERY_S
        elapsed_s = now_s - self._began_s
        of = "" if self.total is None else f"/{self.total:.0f}"
        rest = left_s(self.n, self.total, elapsed_s, self.expected_s)
        left = "" if rest != rest else f", {clock(rest)} left"
        what = f"{self.what}: " if self.what else ""
        print(
            f"{what}{self.n:.0f}{of} {self.unit}, {clock(elapsed_s)}{left}",
            file=sys.stderr,
            flush=True,
        )


def counter(
    total: float | None = None, unit: str = "frame", what: str = "", expected_s: float | None = None
) -> Any:
    """Return what shows progress: a context with ``update(n)`` and ``set_description(text)``.

    Parameters
    ----------
    total
        Rounds; None where nobody knows how many there will be.
    unit
        What a round is.
    what
        What the work is at, where that is said.
    expected_s
        How long it is expected to take, s, where that is known.
    """
    if not sys.stderr.isatty():
        return _Lines(total, unit, what, expected_s)
    form = "{desc}{n:.0f} {unit} [{elapsed}]"
    if total is not None:
        form = "{l_bar}{bar}| {n:.0f}/{total:.0f} {unit} [{elapsed}<{left}]"
    return _Bar(expected_s, total=total, unit=unit, desc=what or None, bar_format=form)


def over(
    rounds: Iterable[T], unit: str = "frame", what: str = "", total: int | None = None
) -> Iterator[T]:
    """Go through rounds and show progress; their number is their length unless it is given."""
    if total is None and isinstance(rounds, Sized):
        total = len(rounds)
    with counter(total, unit, what) as shown:
        for each in rounds:
            yield each
            shown.update()
