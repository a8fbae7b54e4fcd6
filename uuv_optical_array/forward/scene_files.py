"""Scene files: where they are, and how they extend each other, as plain values."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from uuv_optical_array.core.settings import hint
from uuv_optical_array.core.storage import files, yaml_text
from uuv_optical_array.forward.lamp.photometry import BEAM

READY = "config/scenes"
SUFFIXES = ".yaml", ".yml"
EXTENDS = "extends"
MAX_FILES = 8  # each extending the next


class Layer(NamedTuple):
    """A scene file, its own settings, and the scene that it extends, as written; empty: none."""

    file: Path
    settings: Mapping[str, Any]
    extends: str


def ready_scenes() -> list[str]:
    """Return the names of the ready scenes, sorted."""
    return sorted(path.stem for path in files.shared_file(READY).glob("*.yaml"))


def is_file_name(name: str | Path) -> bool:
    """Say whether a name is that of a file, and not of a ready scene."""
    return Path(name).suffix in SUFFIXES


def scene_file(name: str | Path, folder: Path = Path()) -> Path:
    """Find the file of a scene: a path relative to a folder, or the bare name of a ready scene.

    FileNotFoundError where neither has that name.
    """
    if is_file_name(name):
        file = folder / files.user_path(name)
        if not file.is_file():
            raise FileNotFoundError(f"scene {file}: no such file")
        return file
    ready = ready_scenes()
    if str(name) not in ready:
        text = hint(name, ready, "`uuv_array scenes` says what each is")
        raise FileNotFoundError(
            f"scene {name}: neither a .yaml file nor a ready scene ({', '.join(ready)}); {text}"
        )
    return files.shared_file(f"{READY}/{name}.yaml")


def sentence(file: Path) -> str:
    """Return the comment in the first line of a scene file; empty without one."""
    first = file.read_text(encoding="utf-8").partition("\n")[0]
    return first.lstrip("# ") if first.startswith("#") else ""


def own_text(name: str | Path) -> str:
    """Return the text of a user's scene file; empty for a ready scene."""
    return scene_file(name).read_text(encoding="utf-8") if is_file_name(name) else ""


def layers(file: Path) -> list[Layer]:
    """Read a scene file, the one that it extends, and so on.

    ValueError for a file that is no mapping in YAML, and for files that extend each other in a
    circle or that are more than `MAX_FILES`; FileNotFoundError for an extended scene that does not
    exist, with the file that names it.
    """
    result: list[Layer] = []
    while True:
        result.append(_layer(file))
        extends = result[-1].extends
        if not extends:
            return result
        try:
            base = scene_file(extends, file.parent)
        except FileNotFoundError as error:
            raise FileNotFoundError(f"scene {file}: {EXTENDS}: {error}") from None
        chain = [layer.file for layer in result] + [base]
        shown = " -> ".join(path.name for path in chain)
        if any(base.samefile(layer.file) for layer in result):
            raise ValueError(
                f"scene {file}: {EXTENDS}: {shown} is a circle; remove {EXTENDS} from one of them"
            )
        if len(chain) > MAX_FILES:
            raise ValueError(
                f"scene {file}: {EXTENDS}: {shown} are more than {MAX_FILES} files; extend a scene "
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
                f"{EXTENDS}: {extends!r} is not a scene; give the name of a ready one, or a "
                ".yaml file"
            )
    except ValueError as error:
        raise ValueError(f"scene {file}: {error}") from None
    own = {key: settings[key] for key in settings if key != EXTENDS}
    lamp = own.get("lamp")
    if isinstance(lamp, Mapping) and isinstance(lamp.get("photometry"), str):
        # Its path is from the scene's folder.
        path = file.parent / files.user_path(lamp["photometry"])
        own["lamp"] = {**lamp, "photometry": str(path)}
    return Layer(file, own, extends)


def merged(layers_of_scene: Sequence[Layer]) -> Mapping[str, Any]:
    """Return the settings of a scene with all that it extends, from its `layers`.

    ValueError where null removes a key that does not exist.
    """
    *changes, last = layers_of_scene
    settings = last.settings
    for layer in reversed(changes):
        try:
            settings = _changed(_without_beam(settings, layer.settings), layer.settings, "")
        except ValueError as error:
            raise ValueError(f"scene {layer.file}: {error}") from None
    return settings


def _without_beam(base: Mapping[str, Any], changes: Mapping[str, Any]) -> Mapping[str, Any]:
    """Leave out the beam of an extended scene where the lamp of its changes has another.

    A photometric file takes the place of the keys that it stands for, and each of these of a file;
    null speaks for itself.
    """
    lamp, new = base.get("lamp"), changes.get("lamp")
    if not (isinstance(lamp, Mapping) and isinstance(new, Mapping)):
        return base
    given = {key for key, value in new.items() if value is not None}
    gone = {*BEAM} if "photometry" in given else {"photometry"} if given & {*BEAM} else set()
    return {**base, "lamp": {key: lamp[key] for key in lamp if key in new or key not in gone}}


def _changed(base: Mapping[str, Any], changes: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Merge mappings, replace the rest, remove what is null (JSON Merge Patch, RFC 7396)."""
    result = dict(base)
    for key, value in changes.items():
        name = f"{where}.{key}".lstrip(".")
        if value is None:
            if key not in result:
                raise ValueError(
                    f"{name}: null removes a key of the extended scene, which does not have this "
                    "one; leave it out, or give {} for an effect with its defaults"
                )
            del result[key]
        elif isinstance(value, Mapping):
            inner = result.get(key)
            result[key] = _changed(inner if isinstance(inner, Mapping) else {}, value, name)
        else:
            result[key] = value
    return result
