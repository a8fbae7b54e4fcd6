"""YAML by the rules of 1.2: 1e-3 is a number, and a key stands once. The one reader and writer."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.constructor import DuplicateKeyError
from ruamel.yaml.error import MarkedYAMLError, YAMLError

LINE = 1000  # characters, so that no list is broken


def parse(text: str) -> Any:
    """Return plain values.

    Parameters
    ----------
    text
        YAML, one document.

    Raises
    ------
    ValueError
        For what is not YAML or holds a key twice: the line and what is wrong with it.
    """
    try:
        return YAML(typ="safe", pure=True).load(text)
    except DuplicateKeyError as error:
        what = str(error.problem).partition(" with value")[0]
        raise ValueError(f"not YAML: {_line(error)}{what}; keep one") from None
    except MarkedYAMLError as error:
        raise ValueError(f"not YAML: {_line(error)}{error.problem}") from None
    except (YAMLError, ValueError, RecursionError) as error:
        raise ValueError(f"not YAML: {' '.join(str(error).split())}") from None


def read(path: Path) -> Any:
    """Return the plain values of a file; errors as `parse`, and OSError."""
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"not YAML: {error}") from None
    return parse(text)


def _line(error: MarkedYAMLError) -> str:
    return f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""


def text_of(values: Mapping[str, Any]) -> str:
    """Return plain values as YAML, a list of numbers on one line.

    Parameters
    ----------
    values
        Mappings, lists, numbers and words.
    """
    stream = io.StringIO()
    writer = YAML()
    writer.width = LINE
    writer.dump(_document(values), stream)
    return stream.getvalue()


def _document(values: Any) -> Any:
    if isinstance(values, Mapping):
        return CommentedMap({key: _document(value) for key, value in values.items()})
    if isinstance(values, list):
        items = CommentedSeq(_document(value) for value in values)
        if not any(isinstance(value, list) for value in values):
            items.fa.set_flow_style()
        return items
    return values
