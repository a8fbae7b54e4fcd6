"""Pages of results: what a command prints is written into a page of Markdown, beside the command.

For those who maintain the pages: the environment variable `PAGE` names the page of one run.
"""

import contextlib
import io
import os
import shlex
from collections.abc import Callable, Sequence

from uuv_optical_array.cli import outputs
from uuv_optical_array.cli.options import OptionError
from uuv_optical_array.core.storage import files

PAGE = "UUV_ARRAY_REPORT"
BEGIN, END = "<!-- printed by: {} -->", "<!-- end -->"


def filled(page: str, command: str, text: str) -> str:
    """Return a page with what a command printed: in place of what it printed before, or last.

    ValueError where the command's block in the page has no end.
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


def run(program: Callable[[], int], words: Sequence[str]) -> int:
    """Run a program, write what it printed into the page of `PAGE`, if any, and return its code.

    The page gets the command line, too. OptionError, before the program runs, where the page cannot
    be filled.
    """
    if not (name := os.environ.get(PAGE)):
        return program()
    path, command = outputs.file_to_write(name, PAGE), shlex.join(words)

    def fill(text: str) -> str:
        page = path.read_text(encoding="utf-8") if path.exists() else ""
        try:
            return filled(page, command, text)
        except ValueError as error:
            raise OptionError(f"{PAGE} {path}: {error}") from None

    fill("")
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed):
            code = program()
    finally:
        print(printed.getvalue(), end="")
    if code == 0:
        files.write_text(path, fill(printed.getvalue()))
    return code
