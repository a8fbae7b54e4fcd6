"""``uuv_array study measured``: test the package with measured light.

Read a folder with photometric files of lamps (.ies, .ldt), or with places_rss.csv, or both. The
latter has the readings of a photodiode at places in a room with four lamps: columns run, x and y in
m, and four readings. Measured beams are compared with the sums of Gaussians that scenes have, and
light a simulated array that is calibrated and estimates poses. The lamps of the room are calibrated
by one run; then places of the other runs are estimated, and poses of a virtual array whose readings
are interpolated.

  uuv_array study measured light              the folder `light`
  uuv_array study measured light --poses 1000   more poses behind each lamp
  uuv_array study measured light --json       one JSON object
The package has no such files; docs/results/measured.md names the sources of those behind its
figures.
"""

import argparse
from pathlib import Path
from typing import Any

from uuv_optical_array.cli import options, outputs
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.core.storage import files
from uuv_optical_array.studies.measured_light.lamps import files_in, measure_lamps, report_lamps
from uuv_optical_array.studies.measured_light.report import measure_room, report_room
from uuv_optical_array.studies.measured_light.room import FILE
from uuv_optical_array.studies.shared.results import until_interrupted

POSES = 200


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder of measured light")
    options.add_number(parser, "poses", Quantity("poses behind each lamp", "", 1, 1e6), POSES)
    options.add_seed(parser)
    options.add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Run the study and print it."""
    folder = files.user_path(args.folder)
    if not folder.is_dir():
        raise options.OptionError(f"FOLDER {folder}: no such folder; name one of measured light")
    lamps, rooms = files_in(folder), sorted(folder.rglob(FILE))
    if not lamps and not rooms:
        raise options.OptionError(
            f"FOLDER {folder}: it has no .ies or .ldt file and no {FILE}; "
            "docs/results/measured.md says where to get some"
        )
    rows, complete = until_interrupted(measure_lamps(lamps, args.poses, args.seed))
    texts = [report_lamps(rows, args.poses)] if rows else []
    result: dict[str, Any] = {"seed": args.seed, "complete": complete, "lamps": rows, "rooms": []}
    if complete:
        found, complete = until_interrupted(measure_room(each, args.seed) for each in rooms)
        texts += map(report_room, found)
        result |= {"complete": complete, "rooms": found}
    text = "\n\n".join(texts)
    return outputs.finish(args, result, text, complete, "the tables end where the work ended")
