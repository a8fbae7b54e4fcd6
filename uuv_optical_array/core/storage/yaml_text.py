"""YAML by the rules of 1.2: 1e-3 is a number, and a key stands once. The one reader and writer."""

import copy
import io
from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.constructor import DuplicateKeyError
from ruamel.yaml.error import MarkedYAMLError, YAMLError

LINE = 10**9  # characters, so that no list is broken


def parse(text: str) -> Any:
    """Return a document's plain values; ValueError, with the line, for bad YAML or a key twice."""
    try:
        return copy.deepcopy(_plain(text))
    except DuplicateKeyError as error:
        what = str(error.problem).partition(" with value")[0]
        raise ValueError(f"not YAML: {_line(error)}{what}; keep one") from None
    except MarkedYAMLError as error:
        raise ValueError(f"not YAML: {_line(error)}{error.problem}") from None
    except (YAMLError, ValueError, RecursionError) as error:
        raise ValueError(f"not YAML: {' '.join(str(error).split())}") from None


@lru_cache(maxsize=16)
def _plain(text: str) -> Any:
    """Return a document's values, kept for whoever reads the same again: a scene takes 5 ms."""
    return YAML(typ="safe", pure=True).load(text)


def read(path: Path) -> Any:
    """Return the plain values of a file; errors as `parse`, and OSError."""
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"not YAML: {error}") from None
    return parse(text)


def _line(error: MarkedYAMLError) -> str:
    return f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""


def text_of(values: Mapping[str, Any], like: str = "") -> str:
    """Return plain values as YAML, with comments, order and spellings of `like` where keys stay."""
    if like:
        # Comments are lost where keys cannot be set one by one, as where two share an anchor.
        with suppress(YAMLError, LookupError, ValueError):
            document = YAML().load(like)
            if isinstance(document, CommentedMap):
                _set(document, values)
                text = _dumped(document)
                if parse(text) == values:
                    return text
    return _dumped(_document(values))


def _set(document: CommentedMap, values: Mapping[str, Any]) -> None:
    """Make a document that was read with its comments hold the values."""
    for key in [key for key in document if key not in values]:
        del document[key]
    for key, value in values.items():
        if isinstance(value, Mapping) and isinstance(document.get(key), CommentedMap):
            _set(document[key], value)
        elif key not in document or document[key] != value:
            document[key] = _document(value)


def _document(values: Any) -> Any:
    if isinstance(values, Mapping):
        return CommentedMap({key: _document(value) for key, value in values.items()})
    if isinstance(values, list):
        items = CommentedSeq(_document(value) for value in values)
        if not any(isinstance(value, list) for value in values):
            items.fa.set_flow_style()
        return items
    return values


def _dumped(document: Any) -> str:
    stream = io.StringIO()
    writer = YAML()
    writer.width = LINE
    writer.preserve_quotes = True
    writer.dump(document, stream)
    return stream.getvalue()
