"""Progress on standard error: a bar on a terminal, a line now and then in a file."""

import sys
from collections.abc import Iterable, Iterator, Sized
from typing import Any, TypeVar

from tqdm import tqdm

T = TypeVar("T")
EVERY_S = 10.0  # between two lines in a file


class _Lines:
    """Standard error as tqdm writes to it where that is a file: each state in a line, once.

    `begun` once there is a round to show: tqdm 4.57, that of Ubuntu 22.04, cannot be told to wait.
    """

    last, begun = "", False

    def write(self, text: str) -> None:
        if self.begun and (line := text.strip()) not in ("", self.last):
            print(line, file=sys.stderr, flush=True)
            self.last = line

    def flush(self) -> None:
        pass


def counter(total: float | None, unit: str, what: str = "") -> Any:
    """Return a display of progress, a context with ``update(n)``; a `total` of None is unknown."""
    terminal = sys.stderr.isatty()
    form = "{desc}{n:.0f} {unit} [{elapsed}]"
    if total is not None:
        bar = "{percentage:3.0f}%|{bar}| " if terminal else ""
        form = "{desc}" + bar + "{n:.0f}/{total:.0f} {unit} [{elapsed}<{remaining}]"
    how: dict[str, Any] = {"desc": f"{what}: " if what else None, "total": total, "unit": unit}
    lines = _Lines()
    if not terminal:
        how |= {"file": lines, "mininterval": EVERY_S}
    # The remaining time is by the mean speed.
    display = tqdm(bar_format=form, smoothing=0, miniters=1, **how)
    if not terminal:
        display.last_print_t = 0.0  # the first round is due at once
        lines.begun = True
    return display


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
