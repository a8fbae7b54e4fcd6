"""Progress on standard error: a bar on a terminal, a line now and then in a file."""

import sys
from collections.abc import Iterable, Iterator, Sized
from typing import Any, TypeVar

from tqdm import tqdm

T = TypeVar("T")
EVERY_S = 10.0  # between two lines in a file


class _Progress(tqdm):  # type: ignore[misc]  # tqdm has no types
    """tqdm with the remaining time by the mean speed, in whole lines where it writes to a file."""

    last_print_n: float
    n: float
    total: float | None

    def __init__(self, terminal: bool, **options: Any) -> None:
        self.terminal = terminal
        super().__init__(smoothing=0, delay=0 if terminal else 1e-9, **options)
        if not terminal:
            self.last_print_t = 0.0  # the first round is due at once

    def update(self, n: float = 1) -> Any:
        """Count on; what rounding leaves beyond the end is dropped."""
        return super().update(n if self.total is None else min(n, self.total - self.n))

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


def counter(total: float | None, unit: str, what: str = "") -> Any:
    """Return a display of progress, a context with ``update(n)``; a `total` of None is unknown."""
    terminal = sys.stderr.isatty()
    form = "{desc}{n:.0f} {unit} [{elapsed}]"
    if total is not None:
        bar = "{percentage:3.0f}%|{bar}| " if terminal else ""
        form = "{desc}" + bar + "{n:.0f}/{total:.0f} {unit} [{elapsed}<{remaining}]"
    pace = {"mininterval": 0.1 if terminal else EVERY_S, "miniters": 1}
    desc = f"{what}: " if what else None
    return _Progress(terminal, desc=desc, total=total, unit=unit, bar_format=form, **pace)


def over(
    rounds: Iterable[T], unit: str = "frame", total: int | None = None, what: str = ""
) -> Iterator[T]:
    """Go through rounds of a named work, as many as their length or `total`, and show progress."""
    if total is None and isinstance(rounds, Sized):
        total = len(rounds)
    with counter(total, unit, what=what) as bar:
        for item in rounds:
            yield item
            bar.update()
