"""The pages of the nodes' parameters and topics, and what the sources of the nodes declare."""

import ast
import importlib
import inspect
import json
import pkgutil
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from reference_pages.markdown import bounds, choice, entry, first_sentence, table
from uuv_optical_array import nodes
from uuv_optical_array.nodes.bringup.launch_arguments import FOLLOW, FOLLOWER, FORMATION


class Topic(NamedTuple):
    """A topic as a node declares it."""

    node: str
    published: bool
    name: str
    kind: str


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
        "Each is shown with its default and, in brackets, the bounds of a number, in the unit of "
        "its name, or the words to choose from. One with a star is fixed when its node starts. "
        "`config/follow.yaml` explains each.",
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
            else "An argument without a default changes nothing unless you give it, except "
            "`publish_tf` with `rviz`. In the lists below only a new default or meaning is shown.",
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
        "Names in the table can be remapped. They are relative, except those that `others` gives "
        "as absolute. Their publishers are reliable; their subscriptions are best effort, but "
        "those of `follow_state` reliable. `qos_overrides` parameters change both. "
        "Every node also publishes `/diagnostics` (diagnostic_msgs/DiagnosticArray) at 1 Hz; with "
        "`publish_tf` some publish `/tf` or `/tf_static`. `<n>` counts the followers of a leader "
        "alone, `<other>` is each of `others`. In the picture filled marks publish, open ones "
        "subscribe.",
        "![Nodes and topics](../pictures/nodes.svg)",
        table(("topic", "type", "published by", "subscribed by"), rows),
        "\n".join(
            [
                "- `array/image`: mono16, counts; row 0 is the top, column 0 the port edge, unless "
                "the scene has `array.wiring`; images of several lamps lie below one another.",
                "- `array/features`: one point with FLOAT64 `peak`, `column`, `row`, "
                "`skewness_horizontal` and `skewness_vertical`; no point without light. "
                "`array/faint_features`: those of light that came within some seconds and that the "
                "image alone does not show; no message without it.",
                "- `relative_pose`: the follower's `base_link` in the leader's `beacon`, by one "
                "image; `relative_odometry`: the same by the track of many; `leader_pose`: the "
                "lamp in the follower's `base_frame`.",
                "- `follow_state`: [the state](../how_to/operations.md#states) as the message, and "
                "the values `reason`, `since (s)`, on the node's clock, and `for (s)`; at each "
                "change and at 1 Hz. A reliable, transient-local subscriber that comes later gets "
                "the last one.",
                "- `markers`: for RViz, beam and body by `estimator_node`, station and state by "
                "`formation_node`.",
                "- `range`: distance from the lamp to the follower's `base_link`; `odometry`: the "
                "follower's own.",
            ]
        ),
        "What the nodes take depends on parameters:",
        "\n".join(
            [
                "- `estimator_node`: by `least_squares` only `array/image`, so that it needs no "
                "feature node; by the other methods `array/features` and, with `use_image`, the "
                "image of the same stamp. With `use_commands`, `use_imu` and `use_range` also "
                "`cmd_vel`, `imu` and `range`.",
                "- `follower_node`: only its feature node takes `array/image`. Images, key "
                "parameters and tracks go from node to node without a topic; key parameters and "
                "tracks are published, too.",
                "- `formation_node`: `odometry` with `use_odometry`, `leader/odometry` with "
                "`use_leader_odometry`. Its services are `~/engage` (std_srvs/SetBool) and "
                "`~/search` (std_srvs/Trigger).",
                "- A demonstration's leader sets off by the followers' `cmd_vel`, `follow_state` "
                "and `/diagnostics`, and obeys `leader/cmd_vel`.",
            ]
        ),
    ]
