"""Write ``docs/reference/`` and the schema of scenes: ``python docs/generate_reference.py``.

They come from the declarations, as do the drawings of ``drawings.py``. Parameters, topics,
diagnostics, commands, scene keys, effects, mismatches, troubles and public names each get a page,
which ``reference_pages/`` writes. A new node, command, key or effect appears by itself.
"""

import functools
import inspect
import json
from pathlib import Path

from drawings import geometry
from drawings import nodes as nodes_and_topics
from image_way import image_way
from reference_pages.commands import commands
from reference_pages.diagnostics import diagnostics
from reference_pages.mismatches import mismatches, troubles
from reference_pages.nodes import all_topics, parameters, topics
from reference_pages.scenes import effects, scene
from scene_schema import scene_schema
from schematic import schematic
from sphere import sphere

import uuv_optical_array
from uuv_optical_array import load_scene

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs/reference"
PICTURES = ROOT / "docs/pictures"
SCHEMA = ROOT / "config/scene.schema.json"
WRITTEN = "<!-- Written by docs/generate_reference.py. -->"


def api() -> list[str]:
    """Return the page of the public names."""
    names = [name for name in uuv_optical_array.__all__ if name != "__version__"]
    found = {name: getattr(uuv_optical_array, name) for name in names}
    parts = [
        "# Python API",
        "What `import uuv_optical_array` offers, beside `__version__`. Poses are x, y, z in m and "
        "pitch, yaw in rad, of the follower in the lamp's frame. Images are counts, row "
        "0 at the top, column 0 at the port edge, `(side, side)`, or `(L side, side)` of L lamps.",
    ]
    lines = ["```{eval-rst}"]
    for name, thing in found.items():
        kind = "autofunction"
        if inspect.isclass(thing):
            kind = "autoexception" if issubclass(thing, Exception) else "autoclass"
        lines.append(f".. {kind}:: {uuv_optical_array.__name__}.{name}")
        lines += ["   :members:"] if kind == "autoclass" else []
    parts.append("\n".join([*lines, "```"]))
    return parts


WRITERS = parameters, topics, diagnostics, commands, scene, effects, mismatches, troubles, api
PAGES = {page.__name__: page for page in WRITERS}


def text_of(name: str) -> str:
    """Return the text of a page of the reference."""
    heading, *parts = PAGES[name]()
    return "\n\n".join((heading, WRITTEN, *parts)) + "\n"


# The drawings by their files' names.
DRAWINGS = {
    "geometry.svg": geometry,
    "image_way.svg": image_way,
    "nodes.svg": lambda: nodes_and_topics(all_topics()),
    "schematic.svg": schematic,
    "sphere.svg": lambda: sphere(load_scene("follow")),
}


@functools.cache
def drawing(name: str) -> str:
    """Return a drawing by its file's name."""
    return DRAWINGS[name]()


def schema_text() -> str:
    """Return the schema of scenes as it is shipped, JSON."""
    return json.dumps(scene_schema(), indent=1) + "\n"


def main() -> None:
    """Write every page, the drawings and the schema."""
    FOLDER.mkdir(exist_ok=True)
    SCHEMA.write_text(schema_text(), encoding="utf-8")
    for name in DRAWINGS:
        (PICTURES / name).write_text(drawing(name), encoding="utf-8")
    for name in PAGES:
        (FOLDER / f"{name}.md").write_text(text_of(name), encoding="utf-8")


if __name__ == "__main__":
    main()
