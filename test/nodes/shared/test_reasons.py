"""The list of reasons holds every text that a node can show, and no other."""

import ast
import importlib
from pathlib import Path

import pytest
from causes import CAUSES
from reference_pages.diagnostics import VALUES

from uuv_optical_array.nodes import estimator_node
from uuv_optical_array.nodes.shared import reasons
from uuv_optical_array.nodes.shared.reasons import kind_of

PACKAGE = Path(estimator_node.__file__).parents[1]
# Where the texts of diagnostics are made; calls and exceptions whose first argument is one.
SOURCES = ["nodes", "core/messages.py", "estimation"]
SOURCES += ["control/formation.py", "control/following.py", "control/follow_states.py"]
MADE_BY = {"Refused", "NoPose", "Outlier", "StampRefused", "refuse", "warn", "fail"}
# A track that is asked where it is now; and the value of `fit`.
NEVER_SHOWN = {"no track", "as it stands"}
# Keys in dictionaries of the nodes that are no values, but topics, parameters and messages.
NO_VALUES = {"", "features", "image", "table", "/", "cmd_vel", "follower", "follower_", "leader"}


def parameters_of(path):
    """Return the parameters of the node in a module."""
    return importlib.import_module(f"uuv_optical_array.nodes.{path.stem}").PARAMETERS


def beginning(node):
    """Return the constant text that an expression begins with."""
    if isinstance(node, ast.JoinedStr):
        node = node.values[0]
    elif isinstance(node, ast.BinOp):
        node = node.left
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


def texts(path):
    """Yield the beginning of each text in a module, and the line that it stands in."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and node.args:
            called = getattr(node.func, "attr", getattr(node.func, "id", ""))
            made = called in MADE_BY or (called == "append" and path.name == "diagnostics.py")
            if made and (text := beginning(node.args[0])):
                yield text, f"{path.name}:{node.lineno}"
        elif isinstance(node, ast.Return) and ": " in (text := beginning(node.value)):
            yield text, f"{path.name}:{node.lineno}"


def all_texts():
    paths = [path for name in SOURCES for path in [PACKAGE / name, *(PACKAGE / name).rglob("*.py")]]
    return [found for path in paths if path.suffix == ".py" for found in texts(path)]


def kinds_in_code():
    """Return the kinds of all texts, by where they stand; a topic's name before a comma is none."""
    found = {}
    for text, where in all_texts():
        kind = text.partition(":")[0]
        if not kind.endswith(", "):  # what follows is a text of its own
            found.setdefault(kind, where)
    return found


def test_every_text_in_the_code_is_of_a_kind_in_the_list():
    found = kinds_in_code()
    assert len(found) > 20
    assert {kind: at for kind, at in found.items() if not kind_of(kind)}.keys() == NEVER_SHOWN


def test_the_documents_have_a_cause_of_every_kind_and_of_no_other():
    assert CAUSES.keys() == reasons.CURES.keys()


def test_every_kind_in_the_list_is_in_the_code():
    code = "".join(
        path.read_text(encoding="utf-8")
        for path in PACKAGE.rglob("*.py")
        if path.name != "reasons.py" and "studies" not in path.parts
    )
    joined = code.replace('"\n', "")
    missing = {kind for kind in reasons.REFUSALS if f'"{kind}: ' not in joined}
    assert missing == {"rate"}  # by the name that `checked_rate` is given
    assert 'checked_rate("rate", ' in joined
    for kind in ("no input", "old stamps", "future stamps", "zero stamp", "leader waits"):
        assert f'"{kind}: ' in joined


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("imu, not finite: attitude", "not finite"),
        ("leader/odometry, stamp not later: 1 s came after 2 s", "stamp not later"),
        ("table /somewhere: no table there", "table"),
        ("scene harbour: the table's poses have no light", "scene"),
        ("nothing of the kind: at all", ""),
    ],
)
def test_a_text_has_the_kind_that_it_begins_with(text, kind):
    assert kind_of(text) == kind


def keys(path):
    """Yield the beginning of each key that a module gives to the diagnostics."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "answer":
            yield from (keyword.arg for keyword in node.keywords if keyword.arg)
        elif isinstance(node, ast.Dict):
            yield from (beginning(key) for key in node.keys if key is not None)
        elif isinstance(node, ast.DictComp):
            yield beginning(node.key)
        elif isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store):
            yield beginning(node.slice)


def test_the_list_of_values_has_every_value():
    shared = ["nodes/shared/diagnostics.py", "nodes/estimator/figures.py"]
    given = {key for name in shared for key in keys(PACKAGE / name)}
    for path in (PACKAGE / "nodes").glob("*_node.py"):
        given |= {key for key in keys(path) if key not in parameters_of(path)}
    given -= NO_VALUES
    assert {"answered", "learnt_", "std_", "table_margin", "Actual frequency (Hz)"} <= given
    listed = "".join(names for names, *_ in VALUES)
    assert [key for key in sorted(given) if f"`{key}" not in listed] == []
