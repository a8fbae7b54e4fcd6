"""``uuv_array table``: build the signature table of a scene."""

import argparse
from pathlib import Path

from uuv_optical_array.commands.parser import INTERRUPTED, Subparsers, add_command, add_scene, bar
from uuv_optical_array.scene import load_scene
from uuv_optical_array.table import build_table, save_table

DESCRIPTION = """\
Build the signature table of a scene: the five key parameters of every pose on the grid that the
scene's `table` names, free of noise. The folder that is written holds the poses, the parameters,
the scene and its fingerprint; the estimator refuses it in any other scene.

Estimator nodes without a `table` parameter build the same table in the user's cache by
themselves. Build one by hand to ship it with a vehicle or to look at its size beforehand."""

EPILOG = """\
examples:
  uuv_array table                              the default scene, into follow.table/
  uuv_array table --scene reference            another ready scene
  uuv_array table --scene sea.yaml -o /data/t  your own scene, into a folder of your choice"""


def add_parser(subparsers: Subparsers) -> None:
    """Add the subcommand."""
    parser = add_command(
        subparsers,
        "table",
        run,
        "build the signature table of a scene",
        DESCRIPTION,
        EPILOG,
    )
    add_scene(parser, "follow")
    parser.add_argument(
        "-o", "--output", type=Path, help="folder to write (default: SCENE.table here)"
    )


def run(options: argparse.Namespace) -> int:
    """Build and save the table."""
    scene = load_scene(options.scene)
    output = options.output or Path(f"{scene.name}.table")
    try:
        table = build_table(scene, progress=lambda blocks: bar(blocks, "block"))
    except KeyboardInterrupt:
        print("interrupted: nothing written")
        return INTERRUPTED
    save_table(table, output)
    size_mb = (table.poses.nbytes + table.parameters.nbytes) / 1e6
    print(f"{output}: {len(table.poses)} signatures, {size_mb:.0f} MB, scene {scene.name}")
    return 0
