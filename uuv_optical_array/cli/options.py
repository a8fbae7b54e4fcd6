"""Options of the commands, made from the settings that they set."""

import argparse
import difflib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from typing import Annotated, Any, NoReturn, TypeAlias, get_args

from uuv_optical_array.core.settings import Place, Quantity, Setting, check, declared, unknown
from uuv_optical_array.estimation.estimator import EstimatorSettings
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, load_scene
from uuv_optical_array.programs import INTERRUPTED as INTERRUPTED

Settings: TypeAlias = Mapping[str, Setting]
SEED = Quantity("seed of the random numbers that are drawn", "", 0, 2**32 - 1)


class OptionError(ValueError):
    """An option has a value that cannot be used; the command ends with exit code 2."""


@contextmanager
def checking_options() -> Iterator[None]:
    """Turn an error into an `OptionError` where values of options are checked."""
    try:
        yield
    except (ValueError, OSError) as error:
        raise OptionError(str(error)) from error


class Parser(argparse.ArgumentParser):
    """A parser that says which word was perhaps meant, as argparse itself does from Python 3.14."""

    def error(self, message: str) -> NoReturn:
        """End with exit code 2; an unknown choice is answered with the nearest known one."""
        wrong = re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message)
        hint = meant(wrong[1], re.findall(r"[\w-]+", wrong[2])) if wrong else ""
        super().error(message + hint)


def meant(word: str, known: Iterable[str], before: str = "") -> str:
    """Return a hint at the nearest of the known words, with what stands `before` it.

    Empty where none is as near as argparse itself requires from Python 3.14 on.
    """
    near = difflib.get_close_matches(word, known, n=1)
    return f"; did you mean {before}{near[0]}?" if near else ""


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
    parser.set_defaults(run=module.run, prog=parser.prog, parser=parser)
    module.add_options(parser)


def value_of(name: str, setting: Setting, text: str) -> Any:
    """Read and check the value of a setting; whole numbers also as 1e3, places as X,Y,Z."""

    def number(text: str) -> Any:
        with suppress(ValueError):  # what is no number is refused by its check
            value = float(text)
            return int(value) if setting.kind is int and value.is_integer() else value
        return text

    if setting.kind is str:
        return text
    value: Any = text
    if setting.kind is Place:
        value = [number(part) for part in text.strip("[]").split(",")]
    elif not setting.choices:
        value = number(text)
    return check(Annotated[setting.kind, setting.quantity], value, name)


def _option(read: Callable[[str], Any]) -> Callable[[str], Any]:
    """Return the type of an option that is so read; a ValueError has the error's text."""

    def value(text: str) -> Any:
        try:
            return read(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error).removeprefix("value: ")) from None

    return value


def reader(setting: Setting) -> Callable[[str], Any]:
    """Return the function that reads and checks the value of an option."""
    return _option(partial(value_of, "value", setting))


def _described(setting: Setting) -> tuple[str, str]:
    """Return how the value of a setting is written, and its meaning with its default."""
    text, unit, default = setting.quantity.text, setting.quantity.unit, setting.default
    value = f"{{{','.join(setting.choices)}}}" if setting.choices else unit.upper() or "N"
    if setting.kind is Place:
        value, text = "X,Y,Z", f"{text}, {unit}"
    if setting.kind is str:
        value = "NAME"
    if default is None:
        return value, text
    values = default if isinstance(default, tuple) else (default,)
    shown = (f"{one:g}" if isinstance(one, float) else str(one) for one in values)
    return value, f"{text} (default: {','.join(shown)})"


def add_setting(parser: Any, name: str, setting: Setting) -> None:
    """Add the option of one setting; a value out of bounds is an error of the command line."""
    value, text = _described(setting)
    words = {"type": reader(setting), "metavar": value, "default": setting.default}
    parser.add_argument(f"--{name.replace('_', '-')}", help=text.replace("%", "%%"), **words)


def assigned(word: str, settings: Settings) -> tuple[str, str]:
    """Part NAME=VALUE; ValueError for a name of none of the settings, or no value."""
    name, equals, text = word.partition("=")
    if name not in settings:
        raise unknown(name, settings, "")
    if not equals:
        raise ValueError(f"{name}: no value; give {name}=VALUE")
    return name, text


def add_set(parser: argparse.ArgumentParser, settings: Settings) -> None:
    """Add the option of settings, which the help lists; ``dict(args.set)`` has all values."""

    def read(word: str) -> tuple[str, Any]:
        name, text = assigned(word, settings)
        return name, value_of(name, settings[name], text)

    lines = ["{}={}: {}".format(name, *_described(setting)) for name, setting in settings.items()]
    parser.add_argument_group("settings", "\n".join(lines))
    values = [(name, setting.default) for name, setting in settings.items()]
    words: dict[str, Any] = {"action": "append", "type": _option(read), "metavar": "NAME=VALUE"}
    words |= {"default": values, "help": "give a setting its value; may be repeated"}
    parser.add_argument("--set", **words)


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
    add_setting(parser, "method", declared(EstimatorSettings)["method"])


def add_shape(parser: argparse.ArgumentParser) -> None:
    """Add the option that replaces the shape of the scene's array."""
    about = "shape of the array (default: the scene's)"
    parser.add_argument("--shape", choices=get_args(Shape), help=about)


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add the option for programs that read the answer."""
    parser.add_argument("--json", action="store_true", help="print one JSON object")
