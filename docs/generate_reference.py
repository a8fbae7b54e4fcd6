"""Write ``docs/reference/`` and the schema of scenes: ``python docs/generate_reference.py``.

They come from the declarations, as do the drawings of ``drawings.py``. Parameters, topics,
diagnostics, commands, scene keys, effects, mismatches, troubles and public names each get a page. A
new node, command, key or effect appears by itself.
"""

import argparse
import ast
import functools
import importlib
import inspect
import json
import pkgutil
import re
import typing
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from causes import CAUSES
from drawings import geometry
from drawings import nodes as nodes_and_topics
from image_way import image_way
from scene_schema import scene_schema
from schematic import schematic
from sphere import sphere

import uuv_optical_array
from uuv_optical_array import load_scene, nodes
from uuv_optical_array.commands import build_parser
from uuv_optical_array.core.settings import Quantity, Span, declared
from uuv_optical_array.forward.effects import EFFECTS
from uuv_optical_array.forward.lamps import BeaconLamp
from uuv_optical_array.forward.prior import UNCERTAIN
from uuv_optical_array.forward.scene import GROUPS
from uuv_optical_array.forward.scene_files import ready_scenes, scene_file, sentence
from uuv_optical_array.nodes.bringup.launch_arguments import FOLLOW, FOLLOWER, FORMATION
from uuv_optical_array.nodes.shared import reasons
from uuv_optical_array.studies.closed_loops.kinds import KINDS as TROUBLES
from uuv_optical_array.studies.mismatches.kinds import KINDS

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs/reference"
PICTURES = ROOT / "docs/pictures"
SCHEMA = ROOT / "config/scene.schema.json"
WRITTEN = "<!-- Written by docs/generate_reference.py. -->"
# Names, a year and perhaps equations: "Shinozuka and Jan 1972", "Eren et al. 2016, eq. 5".
SOURCE = re.compile(r"[A-Z]\w+(?: and [A-Z]\w+| et al\.)? (?:\d{4}|\(\d{4}\))(?:, eq\. \d+)?")
# The same in parentheses, with whatever else stands there.
CITATION = re.compile(r" \([^()]*\d{4}[^()]*\)")
# What differs between the texts of alike kinds of mismatch.
SIZE = re.compile(r"(\d+(?:\.\d+)?|less|more)")
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

# Values on ``/diagnostics``: names as Markdown, nodes that show them, and what they mean.
VALUES = (
    (
        "`answered`, `refused`, `refused: ...`",
        "all",
        "messages, refused ones also by kind",
    ),
    ("`taken`", "formation", "poses received; `answered` counts commands"),
    ("`passed_over`", "feature in `follower_node`, estimator", "images left out for a newer one"),
    (
        "`Events in window`, `Events since startup`, `Duration of window (s)`, "
        "`Actual frequency (Hz)`",
        "all",
        "answers and their rate",
    ),
    (
        "`Earliest timestamp delay:`, `Latest timestamp delay:`",
        "all",
        "age of a stamp at the answer, s",
    ),
    ("`Timestamp jitter (s)`", "all", "standard deviation of the time between stamps"),
    ("`cure: ...`", "all", "what to do about each text"),
    ("`peak_counts`", "simulator, feature", "brightest detector, counts"),
    (
        "`light_level`, `saturated_share`",
        "feature",
        "brightest detector (near 0: dim), and share of those at full scale",
    ),
    ("`range_m`", "simulator, formation", "distance behind the lamp, m"),
    ("`sea`", "simulator", "differences of the simulated sea from the scene"),
    (
        "`method`, `fit`",
        "estimator",
        "the method; its fit: `compiled`, or slower, in Python, `as it stands`",
    ),
    (
        "`angle_rad`, `runner_up_angle_rad`",
        "estimator",
        "spectral angle to the best signature, and to the runner-up",
    ),
    (
        "`misfit`, `runner_up_misfit`",
        "estimator",
        "probability of larger residuals in this scene; near 0 the sea differs from it",
    ),
    ("`unobservable`", "estimator", "degrees of freedom that the image hardly shows"),
    (
        "`std_x`, `std_y`, `std_z`, `std_pitch`, `std_yaw`",
        "estimator",
        "standard deviation, m and rad",
    ),
    (
        "`table_margin`",
        "estimator",
        "place in the `table`, and its axis: 1 in the middle, 0 at the edge, < 0 beyond",
    ),
    (
        "`own_motion`",
        "estimator",
        "whether `cmd_vel` is used: `told`; `not told`, where none came for `command_timeout_s`, "
        "or by another clock; `contradicted` by the images and not used: the follower does not "
        "obey, or it is not in m/s and rad/s along its own axes; if that lasts, set "
        "`use_commands` to false",
    ),
    ("`range`", "estimator", "difference of the last range from the track, and whether it is used"),
    ("`learnt_...`", "estimator", "estimate of a constant by the track"),
    ("`scene_...`", "estimator", "value to write into the scene, where the sea differs"),
)


class Topic(NamedTuple):
    """A topic as a node declares it."""

    node: str
    published: bool
    name: str
    kind: str


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(
        "| " + " | ".join(re.sub(r"(?<!\\)\|", r"\\|", cell) for cell in line) + " |"
        for line in lines
    )


def first_sentence(text: str | None) -> str:
    """Return the first sentence of a docstring, as Markdown."""
    line = " ".join((text or "").partition("\n\n")[0].split())
    return re.split(r"(?<! al)\. ", line)[0].rstrip(".:").replace("``", "`")


def node_modules() -> Iterator[tuple[str, Any]]:
    """Yield the name and the module of each node."""
    for found in pkgutil.iter_modules(nodes.__path__):
        if found.name.endswith("_node"):
            yield found.name, importlib.import_module(f"{nodes.__name__}.{found.name}")


def parameters() -> list[str]:
    """Return the page of the node parameters and of the launch arguments."""
    nodes_of: dict[str, list[Any]] = {}
    for _, module in node_modules():
        for key, parameter in getattr(module, "PARAMETERS", {}).items():
            nodes_of.setdefault(key, []).append(parameter)
    common = {
        key: parameters[0]
        for key, parameters in nodes_of.items()
        if len(parameters) > 1 and all(other == parameters[0] for other in parameters)
    }
    parts = [
        "# Node parameters",
        "Each is shown with its default and, in brackets, its values, in the unit of its name; "
        "with a star it is fixed when its node starts. `config/follow.yaml` says when to change "
        "which.",
        "## Common parameters",
        parameter_list(common),
    ]
    for name, module in node_modules():
        declarations = getattr(module, "PARAMETERS", {})
        own = {key: value for key, value in declarations.items() if key not in common}
        shared = ", ".join(f"`{key}`" for key in declarations if key in common)
        parts += [f"## `{name}`", first_sentence(module.__doc__) + "."]
        parts += [f"Common: {shared}."] if shared else []
        if own or not declarations:
            parts.append(parameter_list(own) or "Its parameters are those of its parts.")
    above: dict[str, tuple[str, str]] = {}
    for name, arguments in launch_arguments():
        own = {key: value for key, value in arguments.items() if above.get(key) != value}
        same = ", ".join(f"`{key}`" for key in arguments if key not in own)
        if same and above.keys() <= arguments.keys():
            same = "All others"
        lines = []
        for key, (default, text) in own.items():
            written = f"- `{key}:={default}`" if default else f"- `{key}`"
            known = above.get(key, ("", ""))[1] == text
            lines.append(written if known else f"{written}: {text}")
        parts += [
            f"## Arguments of `{name}`",
            f"{same} are as above."
            if same
            else "An argument without a default leaves its parameter as it is unless you give it. "
            "Below, one without a meaning has that of this list.",
            "\n".join(lines),
        ]
        above = above or arguments
    return parts


def parameter_list(declarations: Mapping[str, Any]) -> str:
    """Return node parameters with their defaults, values and meanings."""
    lines = []
    for key, parameter in declarations.items():
        values = choice(parameter.choices)
        if not isinstance(parameter.default, bool | str):
            values = bounds(key, parameter.quantity)
        star = "\\*" if parameter.read_only else ""
        default = json.dumps(parameter.default)
        lines.append(entry(key, default, values, parameter.quantity.text, star))
    return "\n".join(lines)


def setting_list(owner: Any, more: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return the settings that a class or a function declares, with more about some of them."""
    return "\n".join(
        entry(
            key,
            shown(setting.default),
            choice(setting.choices) or bounds(key, setting.quantity) * (setting.kind is not str),
            setting.quantity.text + more.get(key, ""),
        )
        for key, setting in declared(owner).items()
    )


def entry(name: str, default: str, values: str, text: str, mark: str = "") -> str:
    """Return the line of a setting: name and default as in a file, values and meaning."""
    written = f"`{name}: {default}`" if default else f"`{name}`"
    limited = f" ({values})" if values else ""
    return f"- {written}{mark}{limited}" + (f": {text}" if text else "")


def bounds(key: str, quantity: Quantity) -> str:
    """Return the bounds of a setting, with its unit where its key does not end in it."""
    text = quantity.bounds().removeprefix("from ").replace(" to ", "…")
    *_, unit = re.findall(r"[a-z]+", quantity.unit.lower()) or [""]
    carried = unit and re.search(rf"_{unit}\d?$", key)
    return text.removesuffix(f" {quantity.unit}") if carried else text


def choice(words: Iterable[str]) -> str:
    """Return the words that a setting may be."""
    return ", ".join(f"`{word}`" for word in words)


def launch_arguments() -> Iterator[tuple[str, dict[str, tuple[str, str]]]]:
    """Yield the name of each launch file and its arguments, each with default and meaning."""
    yield "follow.launch.py", FOLLOW
    yield "follower.launch.py", FOLLOW | FOLLOWER
    yield "formation.launch.py", FORMATION


class Names(dict[str, Any]):
    """Values by name; a name that a node works out stands for itself, in brackets."""

    def __missing__(self, name: str) -> str:
        return f"<{name}>"


def value_of(expression: ast.expr, names: Mapping[str, Any]) -> Any:
    """Return the value of an expression."""
    return eval(compile(ast.Expression(expression), "node", "eval"), {}, Names(names))


def topics_of(node: str, module: Any) -> Iterator[Topic]:
    """Yield what the source of a node publishes and subscribes to."""
    tree = ast.parse(inspect.getsource(module))
    # A name may be made from the words that a comprehension runs through.
    words: dict[int, Sequence[dict[str, str]]] = {}
    for outer in ast.walk(tree):
        for loop in getattr(outer, "generators", ()):
            if isinstance(loop.iter, ast.Tuple) and isinstance(loop.target, ast.Name):
                values = [{loop.target.id: word} for word in ast.literal_eval(loop.iter)]
                words |= {id(inner): values for inner in ast.walk(outer)}
    for call in ast.walk(tree):
        name = getattr(getattr(call, "func", None), "id", "")
        if re.fullmatch(r"(publish|subscribe)(_\w+)?", name):
            message = value_of(call.args[1], vars(module))
            package = message.__module__.partition(".")[0]
            for values in words.get(id(call), [{}]):
                topic = value_of(call.args[2], vars(module) | values)
                published = name.startswith("publish")
                yield Topic(node, published, topic, f"{package}/{message.__name__}")


def all_topics() -> list[Topic]:
    """Return every topic of every node, and of the parts that it has in a folder of its own."""
    return [
        topic
        for name, module in node_modules()
        for source in (module, *parts_of(name))
        for topic in topics_of(name, source)
    ]


def parts_of(node: str) -> Iterator[Any]:
    """Yield the modules of a node's own folder, as ``nodes/estimator`` is of `estimator_node`."""
    folder = Path(nodes.__file__).parent / node.removesuffix("_node")
    for _, name, _ in pkgutil.iter_modules([str(folder)]):
        yield importlib.import_module(f"{nodes.__name__}.{folder.name}.{name}")


def topics() -> list[str]:
    """Return the page of the topics."""
    nodes_of: dict[tuple[str, str], tuple[list[str], list[str]]] = {}
    for node, published, name, kind in all_topics():
        publishers, subscribers = nodes_of.setdefault((name, kind), ([], []))
        (publishers if published else subscribers).append(f"`{node}`")
    rows = [
        (f"`{name}`", kind, ", ".join(publishers), ", ".join(subscribers))
        for (name, kind), (publishers, subscribers) in sorted(nodes_of.items())
    ]
    return [
        "# Topics",
        "Names are relative and can be remapped. Publishers are reliable, subscriptions have "
        "sensor-data QoS; `qos_overrides` parameters change both. Every node also publishes "
        "`/diagnostics` (diagnostic_msgs/DiagnosticArray) at 1 Hz, with `publish_tf` some `/tf`. "
        "`<n>` counts the followers of a leader alone, `<other>` is each of `others`. Filled marks "
        "publish, open ones subscribe.",
        "![Nodes and topics](../pictures/nodes.svg)",
        table(("topic", "type", "published by", "subscribed by"), rows),
        "\n".join(
            [
                "- `array/image`: mono16, counts; row 0 is the top, column 0 the port edge.",
                "- `array/features`: one point with FLOAT64 `peak`, `column`, `row`, "
                "`skewness_horizontal` and `skewness_vertical`; no point without light.",
                "- `relative_pose`: the follower's `base_link` in the leader's `beacon`, by one "
                "image; `relative_odometry`: the same by the track of many; `leader_pose`: the "
                "lamp in the follower's `base_frame`.",
                "- `follow_state`: what the follower does. Its message is "
                "[the state](../how_to/operations.md#states), its values are `reason`, "
                "`since (s)`, on the clock of the stamps, and `for (s)`. It comes at each change "
                "and at 1 Hz, and those who listen later get the last one.",
                "- `markers`: for RViz, beam and body by `estimator_node`, station and state by "
                "`formation_node`.",
                "- `range`: distance from the lamp to the follower's `base_link`; `odometry`: the "
                "follower's own.",
            ]
        ),
        "`estimator_node` takes `array/image` alone where its `method` is `least_squares`, which "
        "needs no feature node; else it takes `array/features` and, with `use_image`, the image of "
        "the same stamp. With `use_commands`, `use_imu` and `use_range` it takes `cmd_vel`, `imu` "
        "and `range`, too. `formation_node` takes `odometry` with `use_odometry` and "
        "`leader/odometry` with `use_leader_odometry`; its services are `~/engage` "
        "(std_srvs/SetBool) and `~/search` (std_srvs/Trigger). A demonstration's leader hears "
        "`/diagnostics`, sets off by the followers' `cmd_vel` and `follow_state`, and obeys "
        "`leader/cmd_vel`.",
    ]


def diagnostics() -> list[str]:
    """Return the page of the texts that nodes show."""
    parts = [
        "# Diagnostics",
        "The texts on `/diagnostics`, by their beginning, with cause and, in italics, cure. The "
        "topic and a comma may stand before a text. [Operations](../how_to/operations.md) says "
        "where to begin.",
    ]
    for heading, kinds in (
        ("Refused messages", reasons.REFUSALS),
        ("Warnings that last", reasons.WARNINGS),
        ("Errors", reasons.ERRORS),
    ):
        parts += [f"## {heading}", *reason_lists(kinds)]
    return [
        *parts,
        "## Values",
        "Counts are since the start, all else of the last answered message or second. The nodes "
        "are in brackets.",
        "\n".join(f"- {names} ({of}): {meaning}" for names, of, meaning in VALUES),
    ]


def reason_lists(cures: Mapping[str, str]) -> list[str]:
    """Return a list of causes and cures, and one for each cure that many kinds share."""
    common = [cure for cure, count in Counter(cures.values()).items() if count > 1]
    lines = [
        f"- `{kind}`: {CAUSES[kind]} *{cure}*" for kind, cure in cures.items() if cure not in common
    ]
    parts = ["\n".join(lines)]
    for cure in common:
        causes = [f"- `{kind}`: {CAUSES[kind]}" for kind in cures if cures[kind] == cure]
        parts += [f"*{cure}*", "\n".join(causes)]
    return parts


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
        "In a ROS workspace run `ros2 run uuv_optical_array uuv_array COMMAND`, otherwise "
        "`.venv/bin/uuv_array COMMAND`; `--help` has examples. Defaults are in brackets. The exit "
        "code is 1 if the result is negative, such as a lost leader, 2 for a bad value, and 130 "
        "after Ctrl-C; a study then reports what it has.",
        "## Common options",
        option_list({name: of for name, of in common.items() if name not in settings}),
        "By `--set`, of a bag (`calibrate` takes neither commands nor states):",
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


def shown(default: Any) -> str:
    """Return a default as in a file; empty where there is none."""
    if default is None or default is inspect.Parameter.empty:
        return ""
    if isinstance(default, Span):
        return str(list(default))
    return f"{default:g}" if isinstance(default, int | float) else str(default or [])


def scene() -> list[str]:
    """Return the page of the keys of a scene."""
    parts = [
        "# Scene files",
        "A scene is a YAML 1.2 file with the groups below and [`effects`](effects.md). Keys are "
        "shown with their default and, in brackets, their values, in the unit of the key; one "
        "without a default must be given, except where its meaning says when.",
        "## `extends`",
        "The scene that this one changes: a ready one, or a file by its path from this one's "
        "folder. Mappings are merged, lists and values replaced; `null` takes away a setting, an "
        "effect or a group ([RFC 7396](https://www.rfc-editor.org/rfc/rfc7396)).",
        "A YAML language server completes and checks scenes by the JSON schema "
        "`config/scene.schema.json`, which `uuv_array scenes schema` prints, if a line says "
        "`# yaml-language-server: $schema=scene.schema.json`, the path from the scene's folder.",
    ]
    sets = {
        key: f" [{of.calibrated:g}, {of.as_bought:g}]"
        for key, of in UNCERTAIN.items()
        if of.as_bought
    }
    known = " In square brackets: `known: calibrated` and `as_bought`."
    for group, owner in {**GROUPS, "lamps": BeaconLamp}.items():
        told, more = (known, sets) if group == "prior" else ("", {})
        parts += [
            f"## `{group}`",
            f"{first_sentence(owner.__doc__)}.{told}",
            setting_list(owner, more),
        ]
    parts += [
        "## Ready scenes",
        "`uuv_array scenes` lists their key figures; `config/scenes/` has the sources of values.",
    ]
    lines = [
        f"- `{name}`: {sentence(scene_file(name)).removeprefix('Use ')}" for name in ready_scenes()
    ]
    return [*parts, "\n".join(lines)]


def effects() -> list[str]:
    """Return the page of the effects."""
    parts = [
        "# Effects",
        "Only the effects that a scene names are simulated, in this order. [Light and noise]"
        "(../explanation/light.md#effects) explains the forms in brackets, and which settings "
        "exclude each other. Settings are shown as those of [a scene](scene.md); one without a "
        "default must be given, except where there are several ways.",
    ]
    shown_before: set[str] = set()
    for name, effect in EFFECTS.items():
        text = inspect.getdoc(effect.function) or ""
        law = CITATION.sub("", text.splitlines()[0]).rstrip(".").replace("``", "`")
        sources = [re.sub("[()]", "", found) for found in SOURCE.findall(" ".join(text.split()))]
        kinds = inspect.signature(effect.function).return_annotation
        form = ", ".join(part.__name__.lower() for part in typing.get_args(kinds) or (kinds,))
        source = f" Source: {'; '.join(dict.fromkeys(sources))}." if sources else ""
        lines = setting_list(effect.function).splitlines()
        own = [line for line in lines if line not in shown_before]
        same = [f"`{re.findall(r'[a-z_]+', line)[0]}`" for line in lines if line in shown_before]
        shown_before.update(own)
        own += [f"- {', '.join(same)}: as above"] if same else []
        parts += [f"## `{name}`", f"{law} ({form}).{source}", "\n".join(own)]
    return parts


def mismatches() -> list[str]:
    """Return the page of the kinds of mismatch, by what to do about them."""
    parts = [
        "# Kinds of mismatch",
        "How the sea can differ from the scene in `uuv_array study robustness` "
        "([results](../results/robustness.md)), and in italics what to do about it. In brackets "
        "are standard deviations of the prior `known: calibrated`.",
    ]
    for cure in dict.fromkeys(kind.cure for kind in KINDS):
        named = {
            f"`{kind.name}`"
            + ("" if kind.times_prior is None else f" [{kind.times_prior:.2g}]"): kind.what
            for kind in KINDS
            if kind.cure == cure
        }
        parts += [folded(named), f"*{cure}*"]
    return parts


def troubles() -> list[str]:
    """Return the page of the kinds of trouble, by group."""
    parts = [
        "# Kinds of trouble",
        "What befalls a follower in `uuv_array study envelope` "
        "([results](../results/envelope.md)). The estimator is not told. The leader sets off once "
        "all followers are locked, and where nothing else is said goes at 0.5 m/s: straight on in "
        "the groups Darkness and Leader and in a chain, else on the demonstration's path. From "
        "then on the trouble begins after 15 s, or after 20 s where ours goes out beside another "
        "lamp. Wrong detectors, currents, speeds and equal lamps aside are there from the start.",
    ]
    for group in dict.fromkeys(kind.group for kind in TROUBLES):
        named = {f"`{kind.name}`": kind.what for kind in TROUBLES if kind.group == group}
        parts += [f"## {group.capitalize()}", folded(named)]
    return parts


def folded(named: Mapping[str, str]) -> str:
    """Return a list of names and what they mean, where what differs by sizes alone is one."""
    alike: dict[str, list[str]] = {}
    for name, what in named.items():
        alike.setdefault(SIZE.sub("", what), []).append(name)
    lines = []
    for names in alike.values():
        words = zip(*(SIZE.split(named[name]) for name in names), strict=True)
        what = "".join(one_of(list(dict.fromkeys(word))) for word in words)
        lines.append(f"- {', '.join(names)}: {what}")
    return "\n".join(lines)


def one_of(words: Sequence[str]) -> str:
    """Return words as a list in a sentence."""
    return " or ".join(part for part in (", ".join(words[:-1]), words[-1]) if part)


def api() -> list[str]:
    """Return the page of the public names."""
    names = [name for name in uuv_optical_array.__all__ if name != "__version__"]
    found = {name: getattr(uuv_optical_array, name) for name in names}
    parts = [
        "# Python API",
        "What `import uuv_optical_array` offers. Poses are x, y, z in m and pitch, yaw in rad, of "
        "the follower in the lamp's frame; images are counts, row 0 at the top, column 0 at the "
        "port edge.",
    ]
    lines = ["```{eval-rst}"]
    for name, thing in found.items():
        kind = "autofunction"
        if inspect.isclass(thing):
            kind = "autoexception" if issubclass(thing, Exception) else "autoclass"
        lines.append(f".. {kind}:: {uuv_optical_array.__name__}.{name}")
        lines += ["   :members:"] if kind == "autoclass" else []
    parts.append("\n".join([*lines, "```"]))
    return parts


PAGES = {
    page.__name__: page
    for page in (
        parameters,
        topics,
        diagnostics,
        commands,
        scene,
        effects,
        mismatches,
        troubles,
        api,
    )
}


def text_of(name: str) -> str:
    """Return the text of a page of the reference."""
    heading, *parts = PAGES[name]()
    return "\n\n".join((heading, WRITTEN, *parts)) + "\n"


# The drawings by their files' names.
DRAWINGS = {
    "geometry.svg": geometry,
    "image_way.svg": image_way,
    "nodes.svg": lambda: nodes_and_topics(all_topics()),
    "schematic.svg": schematic,
    "sphere.svg": lambda: sphere(load_scene("follow")),
}


@functools.cache
def drawing(name: str) -> str:
    """Return a drawing by its file's name."""
    return DRAWINGS[name]()


def schema_text() -> str:
    """Return the schema of scenes as it is shipped, JSON."""
    return json.dumps(scene_schema(), indent=1) + "\n"


def main() -> None:
    """Write every page, the drawings and the schema."""
    FOLDER.mkdir(exist_ok=True)
    SCHEMA.write_text(schema_text(), encoding="utf-8")
    for name in DRAWINGS:
        (PICTURES / name).write_text(drawing(name), encoding="utf-8")
    for name in PAGES:
        (FOLDER / f"{name}.md").write_text(text_of(name), encoding="utf-8")


if __name__ == "__main__":
    main()
