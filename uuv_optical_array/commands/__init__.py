"""``uuv_array``: every command that is not a node, one file each."""

import argparse
import errno
import os
import sys
from contextlib import suppress

from uuv_optical_array import __version__
from uuv_optical_array.commands import calibrate, commission, estimate, follow, view
from uuv_optical_array.commands.scene import render, scenes, table
from uuv_optical_array.commands.shared import cli, report
from uuv_optical_array.commands.studies import (
    accuracy,
    advise,
    approach,
    design,
    drives,
    limits,
    paper,
    robustness,
    tradeoff,
)

COMMANDS = (
    follow,
    scenes,
    view,
    render,
    calibrate,
    commission,
    estimate,
    table,
    limits,
    accuracy,
    robustness,
    drives,
    tradeoff,
    advise,
    design,
    approach,
    paper,
)


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of ``uuv_array`` with every subcommand."""
    parser = argparse.ArgumentParser(
        prog="uuv_array", description="Relative pose of underwater vehicles by light."
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for command in COMMANDS:
        command.add_parser(subparsers)
    return parser


def main(args: list[str] | None = None) -> None:
    """Run ``uuv_array``; an error the user can mend ends it with one line and exit code 1.

    A Ctrl-C at a moment at which the command itself expects none ends it with a line, too.
    """
    words = sys.argv[1:] if args is None else args
    options = build_parser().parse_args(words)
    try:
        if getattr(options, "report", None):
            code = report.run(options, words)
        else:
            code = options.run(options)
        _flush()
    except (ValueError, OSError) as error:
        with suppress(OSError):
            _flush()
        sys.exit(f"uuv_array {options.command}: {_told(error)}")
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(cli.INTERRUPTED)
    sys.exit(code)


def _told(error: Exception) -> str:
    """Return an error in words, what it is of first; every file but standard output has a name."""
    if isinstance(error, OSError):
        nameless = "standard output" if error.errno in (errno.ENOSPC, errno.EPIPE) else None
        if (name := error.filename or nameless) is not None:
            return f"{name}: {error.strerror}"
    return str(error)


def _flush() -> None:
    """Write out what was printed; what a full disk does not take is told once, and dropped."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise
