"""``uuv_array``: every command that is not a node, one file each."""

import argparse
import errno
import os
import re
import sys
from contextlib import suppress
from decimal import Decimal
from importlib import import_module

from uuv_optical_array import __version__
from uuv_optical_array.cli import options

POWER = re.compile(r"-(\d+\.?\d*|\.\d+)e[-+]?\d{1,3}", re.I)
OWN_OPTIONS = "-h", "--help", "--version"
# In the order of the help; imported with this module, where Ctrl-C ends the process (`programs`).
COMMANDS = {
    name: import_module(f"uuv_optical_array.commands.{name}")
    for name in (
        *("follow", "view", "scenes", "render", "limits", "budget"),
        *("calibrate", "commission", "estimate", "advise", "table"),
    )
}
STUDIES = {
    name: import_module(f"uuv_optical_array.studies.{name}")
    for name in (
        *("accuracy", "robustness", "lasting", "envelope", "drives", "transport"),
        *("measured", "tradeoff", "design", "paper", "approach"),
    )
}


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of ``uuv_array`` with every subcommand."""
    description = "Relative pose of underwater vehicles by light."
    parser = options.Parser(prog="uuv_array", description=description)
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for module in COMMANDS.values():
        options.add_command(subparsers, module)
    about = "measure accuracy, robustness, cost, designs and published results by simulation"
    description = "Measure by simulation what the array and the estimators can do."
    study = subparsers.add_parser("study", help=about, description=description)
    studies = study.add_subparsers(dest="study", required=True, metavar="STUDY")
    for module in STUDIES.values():
        options.add_command(studies, module)
    return parser


def main(words: list[str] | None = None) -> None:
    """Run ``uuv_array``.

    An error is one line, with exit code 2 for an unusable command line, also one that names what is
    not there, and 1 for what fails at run time.
    """
    words = list(map(_plain, sys.argv[1:] if words is None else words))
    if words and words[0] in STUDIES:
        print(f"uuv_array {words[0]}: it is called `uuv_array study {words[0]}`", file=sys.stderr)
        sys.exit(2)
    parser = build_parser()
    _refuse_early_option(parser, words)
    args, others = parser.parse_known_args(words)
    if others:
        begin = others[0].removeprefix("--").partition("=")[0].replace("-", "_")
        near = (n for n, _ in vars(args).get("set", ()) if begin and n.startswith(begin))
        cure = next((f"; it is called `--set {setting}=VALUE`" for setting in near), "")
        word = next((word.partition("=")[0] for word in others if word.startswith("-")), "")
        names = re.findall(r"--([a-z][a-z-]*)", args.parser.format_help())
        cure = cure or options.meant(word.lstrip("-"), names, "--")
        args.parser.error(f"unrecognized arguments: {' '.join(others)}{cure}")
    try:
        code = args.run(args)
        _flush()
    except BrokenPipeError:  # the reader has enough, as `head` has
        with suppress(OSError):
            _flush()
        code = 1
    except (ValueError, OSError) as error:
        with suppress(OSError):
            _flush()
        text = str(error)
        if isinstance(error, OSError):
            # Standard output has no file name.
            nameless = "standard output" if error.errno == errno.ENOSPC else None
            if (name := error.filename or nameless) is not None:
                text = f"{name}: {error.strerror}"
        print(f"{args.prog}: {text}", file=sys.stderr)
        code = 2 if isinstance(error, options.OptionError | FileNotFoundError) else 1
    except KeyboardInterrupt:  # where the command itself expects none
        print("interrupted", file=sys.stderr)
        code = options.INTERRUPTED
    sys.exit(code)


def _refuse_early_option(parser: argparse.ArgumentParser, words: list[str]) -> None:
    """End with an error at an option before the name of a command or study.

    argparse would take the option's value for that name, and name only the value.
    """
    rest = words[1:] if words[:1] == ["study"] else words
    name = rest[0].partition("=")[0] if rest else ""
    if name.startswith("-") and not any(own.startswith(name) for own in OWN_OPTIONS):
        near = options.meant(name, OWN_OPTIONS)
        parser.error(f"unrecognized arguments: {name}{near or '; give options after the command'}")


def _plain(word: str) -> str:
    """Return -1e-3 as -0.001, as argparse takes the former for an option before Python 3.14."""
    return f"{Decimal(word):f}" if POWER.fullmatch(word) else word


def _flush() -> None:
    """Write out what was printed; drop what a full disk does not take."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise
