"""Write what a command prints into a page: ``python docs/fill_page.py PAGE uuv_array limits ...``.

It stands beside its command line, in place of what the same command printed before, or last. A page
alone has all of its commands run again: ``python docs/fill_page.py PAGE``.
"""

import re
import shlex
import subprocess
import sys
from pathlib import Path

BEGIN, END = "<!-- printed -->\n\n```sh\n{}\n```\n", "<!-- end -->"
MAIN = "from uuv_optical_array.commands import main; main()"
PROGRAMS = {"uuv_array": [sys.executable, "-c", MAIN]}  # any other is run by its name


def filled(page: str, command: str, text: str) -> str:
    """Return a page with what a command printed.

    ValueError where the command's block in the page has no end.
    """
    begin = BEGIN.format(command)
    text = "\n".join(line.rstrip() for line in text.strip("\n").splitlines())
    block = f"{begin}\n```text\n{text}\n```\n\n{END}"
    before, found, rest = page.partition(begin)
    if not found:
        return f"{page.rstrip()}\n\n{block}\n".lstrip()
    _, end, after = rest.partition(END)
    if not end or BEGIN.partition("{}")[0] in rest[: len(rest) - len(after)]:
        raise ValueError(f"no line {END} after that of {command}; add it")
    return f"{before}{block}{after}"


def commands_of(page: str) -> list[str]:
    """Return the command lines of a page whose output stands beside them."""
    return re.findall(re.escape(BEGIN).replace(re.escape("{}"), "(.+)"), page)


def main(name: str, *words: str) -> int:
    """Run a command, fill the page, unless the command fails, and return the command's exit code.

    Without one all of the page's are run, and the largest exit code is returned. ValueError, before
    a command runs, where the page cannot be filled.
    """
    if not words:
        lines = commands_of(Path(name).read_text(encoding="utf-8"))
        return max((main(name, *shlex.split(line)) for line in lines), default=0)
    path, command = Path(name), shlex.join(words)

    def with_text(text: str) -> str:
        page = path.read_text(encoding="utf-8") if path.exists() else ""
        return filled(page, command, text)

    with_text("")
    program = PROGRAMS.get(words[0], words[:1])
    done = subprocess.run([*program, *words[1:]], stdout=subprocess.PIPE, text=True, check=False)
    print(done.stdout, end="")
    if done.returncode == 0:
        path.write_text(with_text(done.stdout), encoding="utf-8")
    return done.returncode


if __name__ == "__main__":
    try:
        sys.exit(main(*sys.argv[1:]))
    except (OSError, ValueError) as error:
        sys.exit(f"{sys.argv[1]}: {error}")
