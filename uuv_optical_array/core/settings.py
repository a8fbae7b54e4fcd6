"""A value declared once, with type, unit, bounds and meaning, and the checks that follow.

A declaration is a type hint, ``Annotated[float, Quantity("what it is", "m", 0.1, 10.0)]``,
on a dataclass field, on a keyword-only argument or in a table of node parameters.
"""

import dataclasses
import difflib
import functools
import inspect
import math
import reprlib
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, TypeAlias


@dataclasses.dataclass(frozen=True)
class Quantity:
    """Meaning of a declared value in one sentence, its unit (empty: none) and inclusive bounds.

    A number has bounds, and a word, a switch or a text has none.
    """

    text: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf

    def bounds(self) -> str:
        """Return the bounds as printed in errors and tables."""
        unit = f" {self.unit}" if self.unit else ""
        return f"from {self.low:g} to {self.high:g}{unit}"


# The bounds are those of each number.
Cells: TypeAlias = Sequence[Sequence[int]]  # places on the array, each ``[row, column]``
Place: TypeAlias = tuple[float, float, float]  # x, y and z
Order: TypeAlias = Sequence[int]  # the whole numbers from 0 on, each once, in some order
Numbers: TypeAlias = Sequence[float | int]
Grid: TypeAlias = Sequence[Sequence[float]]  # a number for each detector, ``[row][column]``


class Setting(NamedTuple):
    """How a setting is declared: type as of `check`, default, and whether it may be ``None``."""

    kind: Any
    quantity: Quantity
    default: Any
    optional: bool

    @property
    def choices(self) -> tuple[str, ...]:
        """Words to choose from; empty for other types."""
        return typing.get_args(self.kind) if typing.get_origin(self.kind) is Literal else ()

    @property
    def required(self) -> bool:
        """Whether it has no default."""
        return self.default is inspect.Parameter.empty


MAX_VALUES = 10_000  # of a span
# Likeness of a name of four letters with a slip in one: what differs more is another word.
ONE_SLIP_IN_FOUR = 0.75


class Span(NamedTuple):
    """Evenly spaced values: ``number`` of them from ``start`` to ``stop``, both included."""

    start: float
    stop: float
    number: int


def _number(value: Any, quantity: Quantity, name: str, whole: bool) -> float | int:
    kind = "a whole number" if whole else "a number"
    if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
        raise ValueError(
            f"{name}: {value!r} is not {kind}; give {kind} without a unit, {quantity.bounds()}"
        )
    if not quantity.low <= value <= quantity.high:
        raise ValueError(f"{name}: {value!r} is out of bounds; it must be {quantity.bounds()}")
    return int(value) if whole else float(value) + 0.0  # no -0.0, which prints otherwise


def _list(value: Any, name: str, fault: str, length: int | None = None) -> Sequence[Any]:
    """Return a value that is a list, of the given length; `fault` completes the error."""
    if not isinstance(value, list | tuple) or (length is not None and len(value) != length):
        raise ValueError(f"{name}: {reprlib.repr(value)} is {fault}")
    return value


def _numbers(
    value: Any,
    quantity: Quantity,
    name: str,
    fault: str = "not a list of numbers; give one",
    length: int | None = None,
    whole: bool = False,
) -> list[Any]:
    values = _list(value, name, fault, length)
    return [_number(x, quantity, f"{name}[{i}]", whole) for i, x in enumerate(values)]


def _span(value: Any, quantity: Quantity, name: str) -> Span:
    *ends, count = _list(value, name, "not a span; give [from, to, how many]", 3)
    start, stop = _numbers(ends, quantity, name)
    number = int(_number(count, Quantity("", "values", 1, MAX_VALUES), f"{name}[2]", True))
    if start > stop or (number == 1) != (start == stop):
        raise ValueError(
            f"{name}: [{start:g}, {stop:g}, {number}] is not a span; "
            "give from < to with at least 2 values, or the same value twice with 1"
        )
    return Span(start, stop, number)


def _cells(value: Any, quantity: Quantity, name: str) -> list[list[Any]]:
    cells = _list(value, name, "not a list of places; give [[row, column], ...]")
    named = [(f"{name}[{i}]", cell) for i, cell in enumerate(cells)]
    places = [(at, _list(cell, at, "not a place; give [row, column]", 2)) for at, cell in named]
    return [[_number(index, quantity, at, True) for index in place] for at, place in places]


def _place(value: Any, quantity: Quantity, name: str) -> Place:
    x, y, z = _numbers(value, quantity, name, "not a place; give [x, y, z]", 3)
    return x, y, z


def _order(value: Any, quantity: Quantity, name: str) -> list[int]:
    fault = "not a list of whole numbers; give one"
    order: list[int] = _numbers(value, quantity, name, fault, whole=True)
    seen: set[int] = set()
    for i, place in enumerate(order):
        if place >= len(order) or place in seen:
            fault = "given twice" if place in seen else "too large"
            raise ValueError(
                f"{name}[{i}]: {place} is {fault}; give each number from 0 to {len(order) - 1} once"
            )
        seen.add(place)
    return order


def _grid(value: Any, quantity: Quantity, name: str) -> list[list[float]]:
    fault = "not a square grid; give as many rows as each row has numbers"
    rows = _list(value, name, fault)
    if not rows or any(not isinstance(row, list | tuple) or len(row) != len(rows) for row in rows):
        raise ValueError(f"{name}: {reprlib.repr(value)} is {fault}")
    return [_numbers(row, quantity, f"{name}[{i}]") for i, row in enumerate(rows)]


LISTS: dict[Any, Callable[[Any, Quantity, str], Any]] = {
    Cells: _cells,
    Numbers: _numbers,
    Place: _place,
    Order: _order,
    Grid: _grid,
    Span: _span,
}


def _unwrapped(hint: Any) -> tuple[Any, Quantity, bool]:
    """Return the type that a hint declares, its quantity, and whether it may be ``None``."""
    quantity, optional = Quantity(""), False
    # Python 3.10 wraps the whole hint of an argument with the default None once more.
    while typing.get_origin(hint) in (typing.Annotated, types.UnionType, typing.Union):
        if typing.get_origin(hint) is typing.Annotated:
            hint, quantity = typing.get_args(hint)
        else:
            optional = True
            hint = next(option for option in typing.get_args(hint) if option is not type(None))
    return hint, quantity, optional


def declared(owner: Callable[..., Any]) -> dict[str, Setting]:
    """Return the settings of a dataclass, or of a function's keyword-only arguments."""
    return dict(_declared(owner))


@functools.cache  # to read the hints takes longer than to check the values
def _declared(owner: Callable[..., Any]) -> dict[str, Setting]:
    hints = typing.get_type_hints(owner, include_extras=True)
    settings = {}
    for name, argument in inspect.signature(owner).parameters.items():
        if dataclasses.is_dataclass(owner) or argument.kind is argument.KEYWORD_ONLY:
            kind, quantity, optional = _unwrapped(hints[name])
            settings[name] = Setting(kind, quantity, argument.default, optional)
    return settings


def check(hint: Any, value: Any, name: str) -> Any:
    """Return a value as its declared type; ValueError names key, value, bound and cure.

    The hint is ``float``, ``int``, ``str``, ``Span``, `Numbers`, `Place`, `Cells`, `Order`, `Grid`,
    ``Literal[...]`` or ``T | None``, each bare or ``Annotated`` with a `Quantity`.
    """
    return _checked(*_unwrapped(hint), value, name)


def _checked(kind: Any, quantity: Quantity, optional: bool, value: Any, name: str) -> Any:
    if optional and value is None:
        return None
    if typing.get_origin(kind) is Literal:
        choices = typing.get_args(kind)
        if value not in choices or isinstance(value, bool):
            raise ValueError(f"{name}: {value!r} is unknown; choose {' or '.join(choices)}")
        return value
    if kind is str:
        if not isinstance(value, str):
            raise ValueError(f"{name}: {value!r} is not a text; write it in quotes")
        return value
    if kind in LISTS:
        return LISTS[kind](value, quantity, name)
    return _number(value, quantity, name, whole=kind is int)


def summary(owner: Callable[..., Any]) -> str:
    """Return the first line of the docstring of an owner of settings."""
    return (inspect.getdoc(owner) or "").partition("\n")[0]


def hint(name: Any, known: typing.Iterable[str], otherwise: str) -> str:
    """Ask whether the nearest known name is meant, or say something else where none is near."""
    near = difflib.get_close_matches(str(name), known, n=1, cutoff=ONE_SLIP_IN_FOUR)
    return f"did you mean {near[0]}?" if near else otherwise


def unknown(key: Any, known: typing.Collection[str], where: str) -> ValueError:
    """Return the error for an unknown key, with the nearest known one."""
    text = hint(key, known, f"known here: {', '.join(known)}")
    return ValueError(f"{where}.{key}: unknown key; {text}".lstrip("."))


def check_all(owner: Callable[..., Any], values: Any, where: str) -> dict[str, Any]:
    """Check a mapping of values against the settings of its owner, and fill in defaults.

    ``None`` is empty; `where` is its dotted name. ValueError for a wrong or missing key or value.
    """
    values = {} if values is None else values
    if not isinstance(values, Mapping):
        raise ValueError(f"{where}: {values!r} is not a mapping of keys to values")
    settings = declared(owner)
    for key in values:
        if key not in settings:
            raise unknown(key, settings, where)
    checked = {}
    for name, setting in settings.items():
        kind, quantity, default, optional = setting
        if name in values:
            checked[name] = _checked(kind, quantity, optional, values[name], f"{where}.{name}")
        elif setting.required:
            raise ValueError(f"{where}.{name}: missing; add it to the scene")
        else:
            checked[name] = default
    return checked


def one_way(
    values: Mapping[str, Any], where: str, first: Sequence[str], second: Sequence[str]
) -> bool:
    """Require exactly one of two ways to give the same thing, and return whether it is the second.

    Each way is a list of keys of the checked values, of which ``None`` is not given; `where` is
    their dotted name. ValueError where both or neither are given, or a part of one.
    """
    ways = f"give {' and '.join(first)}, or else {' and '.join(second)}"
    extending = "; null removes what an extended scene gives"
    given = [[key for key in way if values.get(key) is not None] for way in (first, second)]
    if all(given):
        raise ValueError(
            f"{where}.{given[1][0]}: given together with {given[0][0]}; {ways}{extending}"
        )
    taken = second if given[1] else first
    for key in taken:
        if values.get(key) is None:
            raise ValueError(f"{where}.{key}: missing; {ways}")
    return bool(given[1])
