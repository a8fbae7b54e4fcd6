"""Options of the commands, made from the settings that they set."""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated, Any, get_args

from uuv_optical_array.core.settings import Quantity, Setting, check, declared
from uuv_optical_array.estimation.estimator import EstimatorSettings
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, load_scene
from uuv_optical_array.programs import INTERRUPTED as INTERRUPTED

SEED = Quantity("seed of all random numbers", "", 0, 2**32 - 1)


class OptionError(ValueError):
    """An option has a value that cannot be used; the command ends with exit code 2."""


@contextmanager
def checking_options() -> Iterator[None]:
    """Turn an error into an `OptionError` where values of options are checked."""
    try:
        yield
    except (ValueError, OSError) as error:
        raise OptionError(str(error)) from error


def add_command(subparsers: Any, module: Any) -> None:
    """Add the command of a module, of its name and with the help that begins the module.

    Its docstring is a sentence after a colon, the description, and the examples, indented. The
    module has ``add_options(parser)`` and ``run(args)``, which returns the exit code.
    """
    title, _, text = (module.__doc__ or "").partition("\n\n")  # python -OO drops it
    description, _, examples = text.partition("\n\n  ")
    words = {"description": description, "epilog": f"examples:\n  {examples.rstrip()}"}
    words["formatter_class"] = argparse.RawDescriptionHelpFormatter
    name, about = module.__name__.rpartition(".")[2], title.partition(": ")[2].rstrip(".")
    parser = subparsers.add_parser(name, help=about, **words)
    parser.set_defaults(run=module.run, prog=parser.prog)
    module.add_options(parser)


def whole_number(text: str) -> int:
    """Read a whole number, also such as 1e3."""
    value = _number(text, "whole number")
    if not value.is_integer():
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number")
    return int(value)


def _number(text: str, kind: str = "number") -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no {kind}") from None


def add_settings(parser: Any, owner: Callable[..., Any], *names: str) -> None:
    """Add an option for each setting that a dataclass or a function declares, or those named."""
    for name, setting in declared(owner).items():
        if not names or name in names:
            add_setting(parser, name, setting)


def add_setting(parser: Any, name: str, setting: Setting) -> None:
    """Add the option of one setting; a value out of bounds is an error of the command line."""
    option, text = f"--{name.replace('_', '-')}", setting.quantity.text
    if setting.kind is bool:
        parser.add_argument(option, action="store_true", help=text)
        return
    default = setting.default
    if default is not None:
        text += f" (default: {f'{default:g}' if isinstance(default, float) else default})"
    words: dict[str, Any] = {"choices": setting.choices}
    if not setting.choices:
        words = {"type": reader(setting), "metavar": setting.quantity.unit.upper() or "N"}
    parser.add_argument(option, default=default, help=text.replace("%", "%%"), **words)


def reader(setting: Setting) -> Callable[[str], Any]:
    """Return the function that reads and checks the value of an option."""

    def read(text: str) -> Any:
        value = whole_number(text) if setting.kind is int else _number(text)
        try:
            return check(Annotated[setting.kind, setting.quantity], value, "value")
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error).removeprefix("value: ")) from None

    return read


def settings_of(args: argparse.Namespace, owner: Callable[..., Any]) -> dict[str, Any]:
    """Return the values of the options that `add_settings` added, by the name of the setting."""
    return {name: vars(args)[name] for name in declared(owner)}


def add_scene(parser: argparse.ArgumentParser, default: str) -> None:
    """Add the option that names a scene."""
    about = "ready scene or YAML file (default: %(default)s)"
    parser.add_argument("--scene", default=default, help=about)


def scene_of(args: argparse.Namespace) -> Scene:
    """Return the scene that the options name; it is one that can be simulated."""
    with checking_options():
        scene = load_scene(args.scene)
        ForwardModel(scene)
    return scene


def add_number(
    parser: Any, name: str, quantity: Quantity, default: float | None, kind: Any = None
) -> None:
    """Add the option of a number, of the kind of its default unless that is ``None``."""
    add_setting(parser, name, Setting(kind or type(default), quantity, default, optional=False))


def add_seed(parser: Any) -> None:
    """Add the option of the seed of a study."""
    add_number(parser, "seed", SEED, 1)


def add_method(parser: argparse.ArgumentParser) -> None:
    """Add the option that names the estimator's method."""
    add_settings(parser, EstimatorSettings, "method")


def add_shape(parser: argparse.ArgumentParser) -> None:
    """Add the option that replaces the shape of the scene's array."""
    about = "shape of the array (default: the scene's)"
    parser.add_argument("--shape", choices=get_args(Shape), help=about)


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add the option for programs that read the answer."""
    parser.add_argument("--json", action="store_true", help="print one JSON object")
