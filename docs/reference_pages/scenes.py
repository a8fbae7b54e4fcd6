"""The pages of the keys and effects of a scene."""

import inspect
import re
import typing

from reference_pages.markdown import first_sentence, setting_list
from uuv_optical_array.core.settings import declared
from uuv_optical_array.forward.effects import EFFECTS
from uuv_optical_array.forward.lamp.lamps import BeaconLamp
from uuv_optical_array.forward.prior import UNCERTAIN
from uuv_optical_array.forward.scene import GROUPS
from uuv_optical_array.forward.scene_files import ready_scenes, scene_file, sentence

# Names, a year and perhaps equations: "Shinozuka and Jan 1972", "Eren et al. 2016, eq. 5".
SOURCE = re.compile(r"[A-Z]\w+(?: and [A-Z]\w+| et al\.)? (?:\d{4}|\(\d{4}\))(?:, eq\. \d+)?")
# The same in parentheses, with whatever else stands there.
CITATION = re.compile(r" \([^()]*\d{4}[^()]*\)")
PHOTOMETRY = {"beam_sigma_deg": " or `photometry`"}  # a key that another can take the place of


def scene() -> list[str]:
    """Return the page of the keys of a scene."""
    needed = [
        f"`{key}`{PHOTOMETRY.get(key, '')}"
        for owner in GROUPS.values()
        for key, setting in declared(owner).items()
        if setting.required
    ]
    parts = [
        "# Scene files",
        "A scene is a YAML 1.2 file with the groups below and [`effects`](effects.md). Keys are "
        "shown with their default and, in brackets, their values, in the unit of the key. A scene "
        f"that extends none must give {', '.join(needed[:-1])} and {needed[-1]}, and other keys "
        "where their meaning says so.",
        "## `extends`",
        "The scene that this one changes: a ready one, or a file by its path from this one's "
        "folder. As by [RFC 7396](https://www.rfc-editor.org/rfc/rfc7396), mappings are merged, "
        "lists and values replaced; `null` takes away a setting, an effect or a group, which the "
        "extended scene has to have.",
        "`uuv_array scenes schema` prints the JSON schema of scenes, `config/scene.schema.json`. A "
        "YAML language server completes and checks a scene by it, if a line says "
        "`# yaml-language-server: $schema=scene.schema.json`, the path from the scene's folder.",
    ]
    sets = {
        key: f" [{of.calibrated:g}, {of.as_bought:g}]"
        for key, of in UNCERTAIN.items()
        if of.as_bought
    }
    known = (
        " In square brackets: the values by `known: calibrated` and `as_bought`, for what the "
        "scene has; `beam_shape_std` of one Gaussian is 0."
    )
    for group, owner in {**GROUPS, "lamps": BeaconLamp}.items():
        told, more = (known, sets) if group == "prior" else ("", {})
        parts += [
            f"## `{group}`",
            f"{first_sentence(owner.__doc__)}.{told}",
            setting_list(owner, more),
        ]
    parts += [
        "## Ready scenes",
        "`uuv_array scenes` lists their key figures; `config/scenes/` names sources of values.",
    ]
    lines = [
        f"- `{name}`: {sentence(scene_file(name)).removeprefix('Use ')}" for name in ready_scenes()
    ]
    return [*parts, "\n".join(lines)]


def effects() -> list[str]:
    """Return the page of the effects."""
    parts = [
        "# Effects",
        "A scene has only the effects that it, or one that it extends, names. "
        "[Light and noise](../explanation/light.md#effects) explains the forms in brackets, and "
        "which settings exclude each other. Settings are shown as in [a scene](scene.md). One "
        "without a default must be given, except where one of several ways is enough.",
    ]
    shown_before: set[str] = set()
    for name, effect in EFFECTS.items():
        text = inspect.getdoc(effect.function) or ""
        law = CITATION.sub("", text.splitlines()[0]).rstrip(".").replace("``", "`")
        sources = [re.sub("[()]", "", found) for found in SOURCE.findall(" ".join(text.split()))]
        kinds = inspect.signature(effect.function).return_annotation
        form = ", ".join(part.__name__.lower() for part in typing.get_args(kinds) or (kinds,))
        source = f" Source: {'; '.join(dict.fromkeys(sources))}." if sources else ""
        lines = setting_list(effect.function).splitlines()
        own = [line for line in lines if line not in shown_before]
        same = [f"`{re.findall(r'[a-z_]+', line)[0]}`" for line in lines if line in shown_before]
        shown_before.update(own)
        own += [f"- {', '.join(same)}: as above"] if same else []
        parts += [f"## `{name}`", f"{law} ({form}).{source}", "\n".join(own)]
    return parts
