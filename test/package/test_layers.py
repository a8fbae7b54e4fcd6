"""Imports run one way: up the table of the design page, and in no circle within a folder."""

import ast
import re
from graphlib import CycleError, TopologicalSorter

import pytest
from pages import PACKAGE, ROOT

PREFIX = f"{PACKAGE.name}."
DESIGN = (ROOT / "docs/design.md").read_text(encoding="utf-8")
ORDER = re.findall(r"^\| `(\w+)/` \|", DESIGN, re.MULTILINE)


def imports(source):
    """Yield what a module imports of the package, at the top or inside a function."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and f"{node.module}.".startswith(PREFIX):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        yield from (name[len(PREFIX) :] for name in names if name.startswith(PREFIX))


MODULES = {
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts): set(
        imports(path.read_text(encoding="utf-8"))
    )
    for path in PACKAGE.rglob("*.py")
}
FOLDERS = sorted(name.removesuffix("__init__") for name in MODULES if name.endswith("__init__"))


def neighbours(modules, folder):
    """Return what each file or folder of a folder, such as ``core.``, imports of the others."""
    own = {name: name[len(folder) :].split(".")[0] for name in modules if name.startswith(folder)}
    found = {entry: set() for entry in own.values() if entry != "__init__"}
    for name in own.keys() - {f"{folder}__init__"}:
        for other in modules[name]:
            if other.startswith(folder):
                found[own[name]].add(other[len(folder) :].split(".")[0])
    return {entry: others & found.keys() - {entry} for entry, others in found.items()}


def test_the_table_of_the_design_has_every_folder():
    assert sorted(ORDER) == sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))


@pytest.mark.parametrize("folder", ORDER)
def test_a_folder_imports_only_from_those_above_it(folder):
    below = set(ORDER[ORDER.index(folder) :])
    assert not neighbours(MODULES, "")[folder] & below


@pytest.mark.parametrize("folder", FOLDERS)
def test_what_a_folder_has_imports_one_way(folder):
    TopologicalSorter(neighbours(MODULES, folder)).prepare()


@pytest.mark.parametrize(
    "source",
    [
        f"from {PREFIX}a.two import thing",
        f"from {PREFIX}a import two",
        f"import {PREFIX}a.two.inner as inner",
        f"def late():\n    from {PREFIX}a.two import thing",
    ],
)
def test_the_guard_sees_every_way_into_a_circle(source):
    modules = {"a.one": set(imports(source)), "a.two.inner": {"a.one.thing"}}
    with pytest.raises(CycleError):
        TopologicalSorter(neighbours(modules, "a.")).prepare()
