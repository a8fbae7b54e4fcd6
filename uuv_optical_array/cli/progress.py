"""Progress on standard error: a bar on a terminal, a line now and then in a file."""

import sys
from collections.abc import Iterable, Iterator, Sized
from typing import Any, TypeVar

from tqdm import tqdm

T = TypeVar("T")
EVERY_S = 10.0  # between two lines in a file
SETTLED_S = 3.0  # after which the speed so far is worth extrapolating
PRIOR = 0.1  # of the whole: the weight of an expected duration beside the rounds that are done


def left_s(done: float, total: float | None, elapsed_s: float, expected_s: float | None) -> float:
    """Return the time that the rest will take at the mean speed so far, s; nan: not known.

    An expected duration of the whole counts as if a tenth of it had been done at that speed.
    """
    if total is None:
        return float("nan")
    rest = max(0.0, total - done)
    if expected_s is not None:
        done, elapsed_s = done + PRIOR * total, elapsed_s + PRIOR * expected_s
    elif not done or elapsed_s < SETTLED_S:
        return float("nan")
    return rest * elapsed_s / done if rest else 0.0


class _Progress(tqdm):  # type: ignore[misc]  # tqdm has no types
    """tqdm with the remaining time of `left_s`, in whole lines where it writes to a file."""

    last_print_n: float

    def __init__(self, expected_s: float | None, terminal: bool, **options: Any) -> None:
        self.expected_s, self.terminal = expected_s, terminal
        super().__init__(delay=0 if terminal else 1e-9, **options)
        if not terminal:
            self.last_print_t = 0.0  # the first round is due at once

    @property
    def format_dict(self) -> dict[str, Any]:
        """The values of `bar_format`."""
        values = super().format_dict
        rest_s = left_s(values["n"], values["total"], values["elapsed"], self.expected_s)
        return {**values, "left": "?" if rest_s != rest_s else self.format_interval(rest_s)}

    def display(self, msg: str | None = None, pos: int | None = None) -> None:
        """Draw the bar, or write a line."""
        if self.terminal:
            super().display(msg, pos)
        else:
            print(self, file=sys.stderr, flush=True)

    def close(self) -> None:
        """End the bar, or write a last line unless the last one says the same."""
        if self.terminal:
            super().close()
        elif self.n != self.last_print_n:
            self.last_print_n = self.n
            self.display()


def counter(total: float | None, unit: str, expected_s: float | None = None, what: str = "") -> Any:
    """Return a display of progress: a context with ``update(n)`` and ``set_description(text)``.

    The number of rounds and the expected duration, s, may be ``None``: not known.
    """
    terminal = sys.stderr.isatty()
    form = "{desc}{n:.0f} {unit} [{elapsed}]"
    if total is not None:
        bar = "{percentage:3.0f}%|{bar}| " if terminal else ""
        form = "{desc}" + bar + "{n:.0f}/{total:.0f} {unit} [{elapsed}<{left}]"
    return _Progress(
        expected_s,
        terminal,
        desc=f"{what}: " if what else None,
        total=total,
        unit=unit,
        bar_format=form,
        mininterval=0.1 if terminal else EVERY_S,
        miniters=1,
    )


def over(
    rounds: Iterable[T], unit: str = "frame", total: int | None = None, what: str = ""
) -> Iterator[T]:
    """Go through rounds of a named work and show progress.

    Their number is their length unless it is given.
    """
    if total is None and isinstance(rounds, Sized):
        total = len(rounds)
    with counter(total, unit, what=what) as bar:
        for item in rounds:
            yield item
            bar.update()
