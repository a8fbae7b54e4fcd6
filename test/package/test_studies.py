"""No study imports another: what they have in common lies in modules of its own."""

import ast
from pathlib import Path

import pytest

import uuv_optical_array

STUDIES = Path(uuv_optical_array.__file__).parent / "studies"
PREFIX = "uuv_optical_array.studies."


def study_of(path):
    """Name the study that a module belongs to."""
    return path.relative_to(STUDIES).with_suffix("").parts[0]


def studies_imported(source):
    """Name the studies that a module imports, shared or not."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(PREFIX[:-1]):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        found |= {name[len(PREFIX) :].split(".")[0] for name in names if name.startswith(PREFIX)}
    return found


SOURCES = {path: path.read_text(encoding="utf-8") for path in sorted(STUDIES.rglob("*.py"))}
# A study has a command; other modules are what studies have in common.
COMMANDS = {study_of(path) for path, text in SOURCES.items() if "def add_parser(" in text}


@pytest.mark.parametrize("path", SOURCES, ids=[str(path.relative_to(STUDIES)) for path in SOURCES])
def test_a_study_imports_no_other(path):
    assert studies_imported(SOURCES[path]) & COMMANDS <= {study_of(path)}


def test_the_guard_knows_the_studies():
    assert {"accuracy", "drives", "limits"} <= COMMANDS
    assert not COMMANDS & {"closed_loop", "errors", "results"}


@pytest.mark.parametrize(
    "source",
    [
        "from uuv_optical_array.studies.accuracy import measure",
        "from uuv_optical_array.studies import accuracy",
        "import uuv_optical_array.studies.accuracy as a",
        "def late():\n    from uuv_optical_array.studies.accuracy import measure",
    ],
)
def test_the_guard_sees_every_way_to_import_a_study(source):
    assert studies_imported(source) == {"accuracy"}
