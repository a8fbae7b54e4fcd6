"""``--report PAGE``: what a command prints stands in a page of Markdown, beside the command."""

import argparse
import contextlib
import io
import shlex
import sys
from collections.abc import Sequence
from typing import TextIO

from uuv_optical_array.cli import outputs
from uuv_optical_array.core.storage import files

BEGIN, END = "<!-- printed by: {} -->", "<!-- end -->"


class _Both(io.TextIOBase):
    """Text that goes to a stream and is kept."""

    def __init__(self, stream: TextIO) -> None:
        self.stream, self.kept = stream, io.StringIO()

    def write(self, text: str) -> int:
        self.stream.write(text)
        return self.kept.write(text)

    def flush(self) -> None:
        self.stream.flush()

    def isatty(self) -> bool:
        return self.stream.isatty()


UUV_ARRAY = ("uuv_array",)


def command_of(words: Sequence[str], program: Sequence[str] = UUV_ARRAY) -> str:
    """Return the line of a shell for a program's arguments, without ``--report PAGE``."""
    kept, rest = list(program), iter(words)
    for word in rest:
        option, equals, _ = word.partition("=")
        if len(option) > 2 and "--report".startswith(option):  # argparse takes it shortened
            if not equals:
                next(rest)
        else:
            kept.append(word)
    return shlex.join(kept)


def filled(page: str, command: str, text: str) -> str:
    """Return a page with what a command printed: in place of what it printed before, or last.

    Raises
    ------
    ValueError
        Where the command's block in the page has no end.
    """
    begin = BEGIN.format(command)
    text = "\n".join(line.rstrip() for line in text.strip("\n").splitlines())
    block = f"{begin}\n\n```sh\n{command}\n```\n\n```text\n{text}\n```\n\n{END}"
    before, found, rest = page.partition(begin)
    if not found:
        return f"{page.rstrip()}\n\n{block}\n".lstrip()
    _, end, after = rest.partition(END)
    if not end or BEGIN.partition("{}")[0] in rest[: len(rest) - len(after)]:
        raise ValueError(f"no line {END} after {begin}; add it")
    return f"{before}{block}{after}"


def run(args: argparse.Namespace, words: Sequence[str], program: Sequence[str] = UUV_ARRAY) -> int:
    """Run a command, and write what it printed into the page if it ended well.

    Parameters
    ----------
    args
        Of the command, with `run` and the page as `report`.
    words
        The arguments that the options were read from.
    program
        What they were given to.

    Raises
    ------
    ValueError, OSError
        Before the command runs, where the page cannot be filled.
    """
    if getattr(args, "json", False):
        raise ValueError("--report: a page is for readers; leave --json out")
    page = outputs.file_to_write(args.report, "--report")
    command = command_of(words, program)

    def fill(text: str) -> str:
        there = page.read_text(encoding="utf-8") if page.exists() else ""
        try:
            return filled(there, command, text)
        except ValueError as error:
            raise ValueError(f"--report {page}: {error}") from None

    fill("")
    both = _Both(sys.stdout)
    with contextlib.redirect_stdout(both):
        code: int = args.run(args)
    if code == 0:
        files.write_text(page, fill(both.kept.getvalue()))
    return code
