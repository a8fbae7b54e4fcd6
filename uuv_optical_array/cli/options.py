"""What the commands have in common: how options are added and read."""

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeAlias, get_args

from uuv_optical_array.core.settings import Quantity, check
from uuv_optical_array.estimation.estimator import METHODS, EstimatorSettings
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.programs import INTERRUPTED as INTERRUPTED

Subparsers: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
SEED = Quantity("seed of all random numbers", "", 0, 2**32 - 1)


def add_command(
    subparsers: Subparsers,
    name: str,
    run: Callable[[argparse.Namespace], int],
    summary: str,
    description: str,
    epilog: str,
) -> argparse.ArgumentParser:
    """Add a subcommand, its texts kept as they are written; `run` returns the exit code."""
    parser = subparsers.add_parser(
        name,
        help=summary,
        description=description,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run, prog=parser.prog)
    return parser


@dataclass(frozen=True)
class Number:
    """An option that takes a number.

    Parameters
    ----------
    quantity
        Its meaning, unit and bounds.
    default
        A whole number where only such are taken.
    """

    quantity: Quantity
    default: float


def whole_number(text: str) -> int:
    """Read a whole number, also such as 1e3."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not value.is_integer():
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number")
    return int(value)


def add_numbers(parser: Any, numbers: Mapping[str, Number]) -> None:
    """Add options that take numbers, by their names, to a parser or a group of one."""
    for name, number in numbers.items():
        whole = isinstance(number.default, int)
        parser.add_argument(
            f"--{name}",
            type=whole_number if whole else float,
            default=number.default,
            metavar=number.quantity.unit.upper() or "N",
            help=f"{number.quantity.text} (default: {number.default:{'d' if whole else 'g'}})",
        )


def numbers_of(args: argparse.Namespace, numbers: Mapping[str, Number]) -> list[Any]:
    """Return the values of such options in order; ValueError for one that is out of bounds."""
    return [
        check(
            Annotated[type(number.default), number.quantity],
            getattr(args, name.replace("-", "_")),
            f"--{name}",
        )
        for name, number in numbers.items()
    ]


def add_scene(parser: argparse.ArgumentParser, default: str) -> None:
    """Add the option that names a scene."""
    parser.add_argument(
        "--scene", default=default, help="ready scene or YAML file (default: %(default)s)"
    )


def add_method(parser: argparse.ArgumentParser) -> None:
    """Add the option that names the estimator's method."""
    parser.add_argument(
        "--method",
        choices=METHODS,
        default=EstimatorSettings.method,
        help="how poses are found (default: %(default)s)",
    )


def add_shape(parser: argparse.ArgumentParser) -> None:
    """Add the option that replaces the shape of the scene's array."""
    parser.add_argument(
        "--shape", choices=get_args(Shape), help="shape of the array (default: the scene's)"
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add the option for programs that read the answer."""
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def add_report(parser: argparse.ArgumentParser) -> None:
    """Add the option for a page that keeps what is printed; `report` fills it."""
    parser.add_argument(
        "--report",
        type=Path,
        metavar="PAGE",
        help="Markdown page in which this command and what it prints take the place of what it "
        "printed last",
    )
