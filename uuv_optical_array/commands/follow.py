"""``uuv_array follow``: let a follower follow a leader by light, and draw it.

A leader waits until its follower sees it and, once on a machine, until the fit is compiled. Then it
runs straight, turns and changes depth, and the follower keeps station behind it by the light of the
leader's lamp alone. Simulator, feature, estimator, formation and vehicles node run in this one
process, on real ROS 2 topics, with the parameters of follow.launch.py. Messages on leader/cmd_vel
drive the leader. The true sea is drawn from the scene's prior, and its differences from the scene
are printed. At the end the command prints a summary and writes a picture. Several followers swim in
a V, each with its own nodes in a namespace, as in formation.launch.py, by default in the scene
formation.

  uuv_array follow                          60 s of the default scene
  uuv_array follow --seed 1                 with the same sea and noise each time
  uuv_array follow --exact-sea              in exactly the sea that the scene describes
  uuv_array follow --leader-path zigzag     another path of the leader, or one of your own (CSV)
  uuv_array follow --scene sea.yaml         your own lamp, water and array
  uuv_array follow --record run             a bag for uuv_array estimate; needs the extra `bags`
  uuv_array follow --followers 3            a V; the third follower is lit by the first
Ctrl-C ends the run early and reports what there is, with exit code 130. While it runs,
`ros2 topic echo /relative_pose` shows the estimates. Exit code 1: a follower lost its leader, two
vehicles came too near, or another run is on the network (ROS_DOMAIN_ID=7 runs one beside it). A
leader that is found again is not lost: how long the follower was in each state is printed.
"""

import argparse
import sys
from contextlib import nullcontext
from pathlib import Path

import numpy as np
from rich.live import Live
from rich.text import Text

from uuv_optical_array.cli import options, outputs
from uuv_optical_array.control.fleet import MIN_SEPARATION_M, MOST, vee
from uuv_optical_array.control.follow_record import FollowRecord, least_distance
from uuv_optical_array.control.follow_states import COLOURS
from uuv_optical_array.control.vehicles.leader_path import PATHS, leader_path
from uuv_optical_array.core.extras import needs
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.core.storage import files
from uuv_optical_array.plots.follow import draw_follow
from uuv_optical_array.plots.style import save
from uuv_optical_array.recording.bag import BagWriter

DURATION = Quantity("duration of the run from the leader's start", "s", 1e-3, 1e6)
SEED = Quantity(
    "seed of sea and noise, one more for each further follower (default: the parameter file's, by "
    "default a new one)",
    "",
    -1,
    2**31 - 1,
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    about = "ready scene or YAML file (default: the parameter file's; without a file follow, or "
    about += "formation for several followers)"
    parser.add_argument("--scene", help=about)
    about = f"{', '.join(PATHS)} or a CSV file (default: the parameter file's)"
    parser.add_argument("--leader-path", metavar="PATH", help=about)
    options.add_number(parser, "duration", DURATION, 60.0)
    options.add_number(parser, "seed", SEED, None, int)
    about = "the sea is exactly the scene's, not drawn from its prior"
    parser.add_argument("--exact-sea", action="store_true", help=about)
    options.add_number(parser, "followers", Quantity("number of followers", "", 1, MOST), 1)
    unchained = "the leader's lamp lights all followers, at most three"
    parser.add_argument("--no-chain", action="store_true", help=unchained)
    about = "ROS parameters; others keep their default (default: none)"
    parser.add_argument("--params-file", type=Path, metavar="FILE", help=about)
    outputs.add_picture(parser, "follow.png")
    about = "write images, features, poses, odometries, commands and states as a bag, MCAP, to a "
    about += "new folder"
    outputs.add_folder(parser, about, "--record")


def live_line(record: FollowRecord, elapsed_s: float) -> Text:
    """Return the line that a terminal shows while the run goes on."""
    stamps, errors = record.errors()
    if not len(stamps):
        return Text(f"{elapsed_s:5.1f} s   waiting for light")
    error = errors[-1]
    range_m = np.linalg.norm(record.estimates[stamps[-1]][:3])
    error_m, angle_deg = np.linalg.norm(error[:3]), np.degrees(np.linalg.norm(error[3:]))
    line = Text(f"{elapsed_s:5.1f} s   ")
    for state in record.states[-1:]:
        line.append(f"{state.name:12}", COLOURS[state.name])
    return line.append(
        f"range {range_m:5.2f} m   error {error_m:4.2f} m   "
        f"angle {angle_deg:4.1f} deg   {len(stamps)} poses"
    )


def run(args: argparse.Namespace) -> int:
    """Run the demonstration; return 1 when the leader was lost."""
    picture = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    bag_folder = args.record and outputs.folder_to_write(args.record, "--record", new=True)
    if args.params_file is not None and not args.params_file.is_file():
        raise options.OptionError(f"--params-file {args.params_file}: no such file")
    with options.checking_options():
        # One follower takes the station of its parameters.
        fleet = [] if args.followers == 1 else vee(args.followers, not args.no_chain)
        if args.leader_path is not None:
            leader_path(args.leader_path)
    if args.scene is None and fleet and args.params_file is None:
        args.scene = "formation"
    ros_args: list[str] = []
    for file in filter(None, (files.shared_file("config/follow.yaml"), args.params_file)):
        ros_args += ["--params-file", str(file)]
    if args.scene is not None:
        options.scene_of(args)
        ros_args += ["-p", f"scene:={args.scene}"]
    if args.leader_path is not None:
        ros_args += ["-p", f"leader_path:={args.leader_path}"]
    follow = needs("ros", "uuv_optical_array.nodes.bringup.demo").follow
    terminal = sys.stdout.isatty()  # a file would get each line that the next one overwrites
    writer = BagWriter(bag_folder) if bag_folder else nullcontext()
    with Live(auto_refresh=False) as live, writer as bag:

        def on_tick(record: FollowRecord, elapsed_s: float) -> None:
            if terminal:
                live.update(live_line(record, elapsed_s), refresh=True)

        sea = args.seed, args.exact_sea
        records, interrupted = follow(ros_args, args.duration, on_tick, fleet, bag, *sea)
    if bag_folder:
        print(f"bag: {bag_folder}")
    lost = []
    for number, record in enumerate(records, 1):
        name = f"follower {number}: " if fleet else ""
        print(f"{name}sea: {record.sea}")
        print(f"{name}{record.summary()}")
        if reason := record.lost():
            lost.append(f"{name}{reason}")
    if fleet:
        paths = [records[0].leader_path, *(record.follower_path for record in records)]
        least_m = least_distance(paths)
        print(f"least distance between two vehicles: {least_m:.2f} m")
        if least_m < MIN_SEPARATION_M:
            lost.append(f"two vehicles came nearer than {MIN_SEPARATION_M:g} m")
    if all(record.estimates for record in records):
        save(draw_follow(records), picture)
        print(f"picture: {picture}")
    end = "until it was interrupted" if interrupted else "to the end"
    without = "interrupted" if interrupted else "lost the leader"
    print(f"{without}: {'; '.join(lost)}" if lost else f"followed the leader {end}")
    return options.INTERRUPTED if interrupted else int(bool(lost))
