"""The page of the commands and their options."""

import argparse
import inspect
import re
from collections.abc import Iterator, Mapping

from reference_pages.markdown import first_sentence
from uuv_optical_array.commands import build_parser

# The page below docs/ that shows a command at work, unless it is that of a study's name.
READ_MORE = {
    "follow": "tutorials/first_follow.md",
    "view": "how_to/view.md",
    "scenes": "tutorials/own_array.md",
    "render": "tutorials/own_array.md",
    "limits": "explanation/light.md",
    "budget": "explanation/instrument.md",
    "calibrate": "tutorials/calibration.md",
    "commission": "how_to/hardware.md",
    "estimate": "how_to/replay.md",
    "advise": "results/tradeoff.md",
    "table": "how_to/tables.md",
    "design": "results/design_study.md",
}


def options_of(parser: argparse.ArgumentParser) -> dict[str, tuple[str, str]]:
    """Return meaning and default, if any, of each argument of a command, by flags and value."""
    options = {}
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction):
            continue
        if action.choices:
            words = "{" + ", ".join(action.choices) + "}"
        elif action.nargs == 0 or not action.option_strings:
            words = ""
        else:
            metavar = action.metavar or action.dest.upper()
            words = metavar if isinstance(metavar, str) else " ".join(metavar)
        names = ", ".join(action.option_strings) or action.dest
        text = (action.help or "") % {**vars(action), "prog": parser.prog}
        options[f"{names} {words}".strip()] = meaning_and_default(text)
    for group in parser._action_groups:
        if group.title == "settings":
            lines = (line.partition(": ") for line in str(group.description).splitlines())
            options |= {name: meaning_and_default(text) for name, _, text in lines}
    return options


def meaning_and_default(text: str) -> tuple[str, str]:
    """Part the help of an option."""
    meaning, default = text.replace("(default: ", "("), ""
    if meaning != text and meaning.endswith(")"):  # the default stands last
        meaning, _, default = meaning[:-1].rpartition(" (")
    return meaning.replace("<", "&lt;"), default


def option_list(options: Mapping[str, tuple[str, str]]) -> str:
    """Return options with their meanings and defaults."""
    return "\n".join(
        f"- `{name}`: {meaning}" + f" ({default})" * bool(default)
        for name, (meaning, default) in options.items()
    )


def command_parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Yield the parser of every command, the studies among them."""
    if parser._subparsers is None:
        yield parser
        return
    (subparsers,) = parser._subparsers._group_actions
    for command in subparsers.choices.values():
        yield from command_parsers(command)


def commands() -> list[str]:
    """Return the page of the commands."""
    parsers = list(command_parsers(build_parser()))
    defaults: dict[tuple[str, str], list[str]] = {}
    for parser in parsers:
        for name, (meaning, default) in options_of(parser).items():
            defaults.setdefault((name, meaning), []).append(default)
    most: dict[str, int] = {}
    for (name, _), found in defaults.items():
        most[name] = max(most.get(name, 2), len(found))
    # What several commands have is common, with its default if that is the same for all; of a name
    # with several meanings, the one that most commands have.
    common = {
        name: (meaning, found[0] if len(set(found)) == 1 else "")
        for (name, meaning), found in defaults.items()
        if len(found) == most[name]
    }
    settings = [name for name in common if re.match(r"\w+=", name)]
    parts = [
        "# Commands",
        "In a ROS workspace run `ros2 run uuv_optical_array uuv_array COMMAND`; in a clone, after "
        "`make follow`, `.venv/bin/uuv_array COMMAND`. `COMMAND --help` has examples. Defaults are "
        "in brackets.",
        "The exit code is 2 for an invalid command line or scene and for a file that does not "
        "exist, 130 after Ctrl-C, and 1 for another failure or a negative result, such as a lost "
        "leader.",
        "## Common options",
        option_list({name: of for name, of in common.items() if name not in settings}),
        "Settings of a bag or a table, for `--set`; `calibrate` takes neither commands nor states, "
        "`view` no table, `commission` only the images:",
        option_list({name: common[name] for name in settings}),
    ]
    for parser in parsers:
        own, shared, found = {}, [], options_of(parser)
        for name, (meaning, default) in found.items():
            meant, of_all = common.get(name, ("", ""))
            if meant == meaning and name not in settings:
                of_this = f" ({default})" * (default != of_all)
                shared.append(f"`{name.split()[0].rstrip(',')}`{of_this}")
            elif name not in settings or len(found.keys() & {*settings}) == 1:
                own[name] = meaning, default
        name = parser.prog.split()[-1]
        page = READ_MORE.get(name, f"results/{name}.md")
        module = inspect.getmodule(parser.get_default("run"))
        described = first_sentence(inspect.getdoc(module)).partition(": ")[2]
        described = described[0].upper() + described[1:]
        parts += [f"## `{parser.prog}`", f"[{described}](../{page})."]
        parts += [", ".join(shared) + "."] if shared else []
        parts += [option_list(own)] if own else []
    return parts
