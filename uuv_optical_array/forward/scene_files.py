"""Where scene files lie, and what a scene takes from the one that it extends, as plain values."""

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

from uuv_optical_array.core.storage import files, yaml_text

READY = "config/scenes"
SUFFIXES = ".yaml", ".yml"
EXTENDS = "extends"
DEEPEST = 8  # files in a row, each extending the next


class Layer(NamedTuple):
    """A scene file as it stands.

    Parameters
    ----------
    file
        The file.
    settings
        What it sets, without `extends`.
    extends
        Name or path of the scene that it extends, as written; empty where it stands alone.
    """

    file: Path
    settings: Mapping[str, Any]
    extends: str


def ready_scenes() -> list[str]:
    """Return the names of the ready scenes, sorted."""
    return sorted(path.stem for path in files.shared_file(READY).glob("*.yaml"))


def is_file_name(name: str | Path) -> bool:
    """Say whether a scene is named by its file, and not as a ready one."""
    return Path(name).suffix in SUFFIXES


def scene_file(name: str | Path, folder: Path = Path()) -> Path:
    """Find the file of a scene.

    Parameters
    ----------
    name
        A file, or the bare name of a ready scene.
    folder
        From where a relative path leads to the file.

    Raises
    ------
    FileNotFoundError
        Where neither a file nor a ready scene has that name.
    """
    if is_file_name(name):
        file = folder / files.user_path(name)
        if not file.is_file():
            raise FileNotFoundError(f"scene {file}: no such file")
        return file
    ready = ready_scenes()
    if str(name) not in ready:
        near = [f"; did you mean {found}?" for found in get_close_matches(str(name), ready, n=1)]
        raise FileNotFoundError(
            f"scene {name}: neither a .yaml file nor a ready scene ({', '.join(ready)})"
            + "".join(near)
        )
    return files.shared_file(f"{READY}/{name}.yaml")


def sentence(file: Path) -> str:
    """Return what a scene file says of itself in its first line; empty without such a comment."""
    first = file.read_text(encoding="utf-8").partition("\n")[0]
    return first.lstrip("# ") if first.startswith("#") else ""


def own_text(name: str | Path) -> str:
    """Return the text of a user's scene file; empty for a ready scene."""
    return scene_file(name).read_text(encoding="utf-8") if is_file_name(name) else ""


def layers(file: Path) -> list[Layer]:
    """Read a scene file, the one that it extends, and so on.

    Raises
    ------
    ValueError
        For a file that is no mapping in YAML, and for files that extend each other in a circle or
        in a row of more than 8.
    FileNotFoundError
        For a scene to extend that is not there, by the file that names it.
    """
    found: list[Layer] = []
    while True:
        found.append(_layer(file))
        extends = found[-1].extends
        if not extends:
            return found
        try:
            base = scene_file(extends, file.parent)
        except FileNotFoundError as error:
            raise FileNotFoundError(f"scene {file}: {EXTENDS}: {error}") from None
        row = [layer.file for layer in found] + [base]
        shown = " -> ".join(path.name for path in row)
        if any(base.samefile(layer.file) for layer in found):
            raise ValueError(
                f"scene {file}: {EXTENDS}: {shown} is a circle; let one of them stand alone"
            )
        if len(row) > DEEPEST:
            raise ValueError(
                f"scene {file}: {EXTENDS}: {shown} are more than {DEEPEST} files; extend a scene "
                "nearer to the last of them"
            )
        file = base


def _layer(file: Path) -> Layer:
    try:
        settings = yaml_text.read(file)
        if not isinstance(settings, Mapping):
            raise ValueError(f"{settings!r} is not a mapping of groups")
        extends = settings.get(EXTENDS, "")
        if EXTENDS in settings and not (isinstance(extends, str) and extends):
            raise ValueError(
                f"{EXTENDS}: {extends!r} is no scene; give the name of a ready one or a .yaml file"
            )
    except ValueError as error:
        raise ValueError(f"scene {file}: {error}") from None
    return Layer(file, {key: settings[key] for key in settings if key != EXTENDS}, extends)


def merged(found: Sequence[Layer]) -> Mapping[str, Any]:
    """Return the settings of a scene with all that it extends.

    Parameters
    ----------
    found
        As `layers` returns them.

    Raises
    ------
    ValueError
        Where a key is taken away that is not there.
    """
    *changes, last = found
    settings = last.settings
    for layer in reversed(changes):
        try:
            settings = _changed(settings, layer.settings, "")
        except ValueError as error:
            raise ValueError(f"scene {layer.file}: {error}") from None
    return settings


def _changed(base: Mapping[str, Any], changes: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Merge mappings, replace the rest, take away by null (JSON Merge Patch, RFC 7396)."""
    result = dict(base)
    for key, value in changes.items():
        name = f"{where}.{key}".lstrip(".")
        if value is None:
            if key not in result:
                raise ValueError(
                    f"{name}: null takes away what the extended scene sets, and it does not set "
                    "this; leave it out, or give {} for an effect with its defaults"
                )
            del result[key]
        elif isinstance(value, Mapping):
            inner = result.get(key)
            result[key] = _changed(inner if isinstance(inner, Mapping) else {}, value, name)
        else:
            result[key] = value
    return result
