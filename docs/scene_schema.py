"""The JSON schema of scene files, with which an editor completes and checks them.

It follows from the declarations: types, bounds, words, defaults and required keys. Conditions on
several keys are left to `scene.scene_from_settings`.
"""

from collections.abc import Callable
from typing import Any

from uuv_optical_array.core.settings import (
    MAX_VALUES,
    Cells,
    Grid,
    Numbers,
    Order,
    Quantity,
    Setting,
    Span,
    declared,
    summary,
)
from uuv_optical_array.forward.effects import EFFECTS
from uuv_optical_array.forward.lamp.lamps import MOST_LAMPS, BeaconLamp
from uuv_optical_array.forward.scene import GROUPS
from uuv_optical_array.forward.scene_files import EXTENDS, ready_scenes

Schema = dict[str, Any]
BEAM = "beam_sigma_deg"  # which a photometric file may stand for


def scene_schema() -> Schema:
    """Return the schema, JSON Schema draft 7, the latest that editors of YAML share."""
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "Scene of uuv_optical_array",
        "if": {"required": [EXTENDS]},
        "then": {"$ref": "#/definitions/changes"},
        "else": {"$ref": "#/definitions/whole"},
        "definitions": {"whole": _scene(whole=True), "changes": _scene(whole=False)},
    }


def _scene(whole: bool) -> Schema:
    """Return the schema of a scene that stands alone, or of what changes another."""
    effects = {
        name: _nullable(_mapping(effect.function, whole), not whole)
        for name, effect in EFFECTS.items()
    }
    groups = {name: _mapping(owner, whole) for name, owner in GROUPS.items()}
    if whole:
        lamp = [key for key in groups["lamp"].pop("required") if key != BEAM]
        ways = [{"required": [*lamp, key]} for key in (BEAM, "photometry")]
        groups["lamp"] |= {"anyOf": ways}
    groups["effects"] = _object(effects, "Only what is named is simulated.")
    lamps = _list(_mapping(BeaconLamp, whole=True))
    groups["lamps"] = {**lamps, "description": summary(BeaconLamp), "maxItems": MOST_LAMPS}
    required = [name for name, group in groups.items() if "required" in group or "anyOf" in group]
    return {
        "type": "object",
        "properties": {
            EXTENDS: {
                "description": "The scene that this one changes: a ready one, or a .yaml file.",
                "type": "string",
                "anyOf": [{"enum": ready_scenes()}, {"pattern": r"\.ya?ml$"}],
            },
            **{
                name: _nullable(group, not whole or name not in required)
                for name, group in groups.items()
            },
        },
        "additionalProperties": False,
        "required": required,
    }


def _mapping(owner: Callable[..., Any], whole: bool) -> Schema:
    settings = declared(owner)
    schema = _object(
        {
            key: _nullable(_value(setting), setting.optional or not whole)
            for key, setting in settings.items()
        },
        summary(owner),
    )
    required = [key for key, setting in settings.items() if setting.required]
    return {**schema, "required": required} if whole and required else schema


def _object(properties: Schema, description: str) -> Schema:
    return {
        "description": description,
        "type": "object",
        "properties": properties,
        "additionalProperties": False,
    }


def _nullable(schema: Schema, null: bool) -> Schema:
    """Return the schema, with null allowed or not."""
    if not null:
        return schema
    if "enum" in schema:
        return {**schema, "enum": [*schema["enum"], None]}
    return {**schema, "type": [schema["type"], "null"]}


def _value(setting: Setting) -> Schema:
    kind, quantity, default, _ = setting
    words = [] if setting.choices or kind is str else [quantity.bounds()]
    texts = [text for text in (quantity.text, *words) if text]
    schema: Schema = {"description": "; ".join(texts)} if texts else {}
    if not setting.required and default is not None:
        schema["default"] = list(default) if isinstance(default, tuple) else default
    if setting.choices:
        return {**schema, "enum": list(setting.choices)}
    if kind is str:
        return {**schema, "type": "string"}
    number, whole = _number("number", quantity), _number("integer", quantity)
    if kind is Span:
        many = _number("integer", Quantity("", low=1, high=MAX_VALUES))
        return {**schema, **_list([number, number, many], 3)}
    if kind == Cells:
        return {**schema, **_list(_list(whole, 2))}
    if kind == Numbers:
        return {**schema, **_list(number)}
    if kind == Grid:
        return {**schema, **_list({**_list(number), "minItems": 1}), "minItems": 1}
    if kind == Order:
        return {**schema, **_list(whole), "uniqueItems": True}
    return {**schema, **(whole if kind is int else number)}


def _number(kind: str, quantity: Quantity) -> Schema:
    return {"type": kind, "minimum": quantity.low, "maximum": quantity.high}


def _list(items: Schema | list[Schema], length: int | None = None) -> Schema:
    schema: Schema = {"type": "array", "items": items}
    return schema if length is None else {**schema, "minItems": length, "maxItems": length}
