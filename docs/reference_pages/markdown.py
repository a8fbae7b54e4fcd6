"""Parts of the pages in Markdown: tables, and lists of settings."""

import inspect
import re
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from uuv_optical_array.core.settings import Quantity, Span, declared


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


def shown(default: Any) -> str:
    """Return a default as in a file; empty where there is none."""
    if default is None or default is inspect.Parameter.empty:
        return ""
    if isinstance(default, Span):
        return str(list(default))
    return f"{default:g}" if isinstance(default, int | float) else str(default or [])
