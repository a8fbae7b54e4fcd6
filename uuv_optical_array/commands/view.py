"""``uuv_array view``: watch a follow in the browser.

Serve a page that shows leader, follower, beam and array in 3-D, the true pose, the estimated one
with its three sigma, the array's image, its brightest reading, and the errors over time. Without a
bag a follower follows a leader in a simulation, in real time. Sliders change sea, lamp and station,
which the estimator does not know. With a bag, the poses of its images are estimated as by
`uuv_array estimate --track`, and a time line chooses the moment. view_node serves such a page for
live ROS topics.

  uuv_array view                            open the address that it prints
  uuv_array view --scene night_plume        in another sea
  uuv_array view sea --scene sea.yaml       a recorded bag; needs the extra `bags`
  uuv_array view --address 0.0.0.0:8080     for browsers on other machines, too
  uuv_array view --screenshot view.png      a picture by a Chromium; no window opens
Ctrl-C ends it with exit code 130. Needs viser (pip install viser), but no ROS. Whoever has the
printed address can operate the page: keep its last part, which is new each time, secret.
"""

import argparse
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from uuv_optical_array.cli import bag, options, outputs
from uuv_optical_array.core.settings import Quantity, Setting
from uuv_optical_array.core.storage import files
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.view import LOOPBACK, PORT

SEED = Quantity("seed of the noise (default: a new one)", "", 0, options.SEED.high)
PORTS = Setting(int, Quantity("port of the page", "", 1, 65535), PORT, optional=False)
SCREENSHOT_S = 45.0  # time of the simulation or the bag that --screenshot shows


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    bag.add_bag(parser, without="simulate")
    options.add_scene(parser, "follow")
    options.add_method(parser)
    options.add_number(parser, "seed", SEED, None, int)
    here = f"(default: {LOOPBACK}:{PORT}, this machine alone)"
    served = f"where the page is served; a port in use gives the next free one {here}"
    parser.add_argument("--address", type=address, default="", metavar="HOST:PORT", help=served)
    about = f"write a picture at {SCREENSHOT_S:g} s, or at the end of a shorter bag, and end"
    parser.add_argument("--screenshot", type=Path, metavar="PNG", help=about)


def address(text: str) -> tuple[str, int]:
    """Read a host, of IPv6 in brackets, a colon and a port; each may be left out."""
    host, _, port = text.partition(":")
    if text.startswith("["):  # of IPv6
        host, _, port = text[1:].partition("]")
        port = port.removeprefix(":")
    return host or LOOPBACK, options.reader(PORTS)(port or str(PORT))


def run(args: argparse.Namespace) -> int:
    """Serve the page until it is interrupted."""
    from uuv_optical_array.view.browser import Browser
    from uuv_optical_array.view.page import Page
    from uuv_optical_array.view.recorded import play
    from uuv_optical_array.view.simulation import simulate

    picture = args.screenshot and outputs.file_to_write(args.screenshot, "--screenshot", (".png",))
    for name, value in args.set if args.bag is None else ():
        if value != bag.READING[name].default:
            raise options.OptionError(f"--set {name}: no bag is read; name one, or leave it out")
    scene = options.scene_of(args)
    recording = bag.read_bag(args, scene, poses_needed=False) if args.bag else None
    for line in recording.left_out if recording else ():
        print(line)
    with ExitStack() as stack:
        title = files.shown(args.bag) if args.bag else f"simulation of {scene.name}"
        page = Page(scene, f"uuv_optical_array: {title}", *args.address)
        stack.callback(page.close)
        print(f"open {page.url} in a browser; Ctrl-C ends it", flush=True)
        browser = stack.enter_context(Browser(page.url)) if picture else None
        shown_s, end_s = 0.0, SCREENSHOT_S
        if recording is not None:
            end_s = min(end_s, np.ptp(recording.stamps_ns) * 1e-9)  # a bag may be shorter

        def goes_on(t_s: float) -> bool:
            nonlocal shown_s
            shown_s = t_s
            return picture is None or t_s < end_s

        estimator = Estimator(scene, args.method)
        if recording is None:
            simulate(page, estimator, args.seed, goes_on)
        else:
            play(page, estimator, recording, goes_on)
        if browser is not None:
            browser.until(f"document.body.innerText.includes('{shown_s:.1f} s')")
            picture.write_bytes(browser.picture())
            print(f"picture: {picture}")
    return 0
