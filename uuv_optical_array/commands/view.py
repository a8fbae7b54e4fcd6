"""``uuv_array view``: watch a follow in the browser."""

import argparse
from contextlib import ExitStack
from pathlib import Path

from uuv_optical_array.cli import options, outputs
from uuv_optical_array.cli.bag import add_bag, read_bag
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.view import LOOPBACK, PORT

DESCRIPTION = """\
Serves a page that shows leader, follower, beam and array in 3-D, the true pose and the estimated
one with its three sigma, the array's image, the light, and the errors over time. Without a bag a
follower follows a leader in a simulation, in real time; sliders change the sea, the lamp and the
station while it runs, of which the estimator is told nothing. With a bag, its images are estimated
anew, as by `uuv_array estimate --track`, and a time line moves through them. The page of live ROS
topics is that of view_node."""

EPILOG = """\
examples:
  uuv_array view                            open http://127.0.0.1:8080
  uuv_array view --scene night_plume        in another sea
  uuv_array view sea --scene sea.yaml       a recorded bag; needs the extra `bags`
  uuv_array view --host 0.0.0.0             for browsers on other machines, too
  uuv_array view --screenshot view.png      its picture, by a Chromium; no window opens
Ctrl-C ends it with exit code 130. Needs the extra `view` (pip install 'uuv_optical_array[view]'),
but no ROS. The page takes orders from whoever can open it: beyond 127.0.0.1 that is everyone on the
network."""

NUMBERS = {
    "port": options.Number(
        Quantity("where the page is served; the next free one", "", 1, 65535), PORT
    ),
    "screenshot-after": options.Number(
        Quantity("time that --screenshot shows", "s", 0.1, 3600), 45.0
    ),
}


def add_parser(subparsers: options.Subparsers) -> None:
    """Add the subcommand."""
    parser = options.add_command(
        subparsers, "view", run, "watch a follow in the browser", DESCRIPTION, EPILOG
    )
    add_bag(parser, required=False, commands=True)
    options.add_scene(parser, "follow")
    options.add_method(parser)
    parser.add_argument("--seed", type=int, help="seed of the noise (default: a new one)")
    parser.add_argument(
        "--host", default=LOOPBACK, help="address to serve (default: %(default)s, this machine)"
    )
    parser.add_argument("--screenshot", type=Path, metavar="PNG", help="take a picture, and end")
    options.add_numbers(parser, NUMBERS)


def run(args: argparse.Namespace) -> int:
    """Serve the page until it is interrupted."""
    from uuv_optical_array.view.browser import Browser
    from uuv_optical_array.view.page import Page
    from uuv_optical_array.view.recorded import play
    from uuv_optical_array.view.simulation import simulate

    port, shown_s = options.numbers_of(args, NUMBERS)
    picture = args.screenshot and outputs.file_to_write(args.screenshot, "--screenshot", (".png",))
    scene = options.scene_of(args)
    recording = read_bag(args, scene, poses_needed=False) if args.bag else None
    with ExitStack() as stack:
        title = args.bag.name if args.bag else f"simulation of {scene.name}"
        page = Page(scene, f"uuv_optical_array: {title}", args.host, port)
        stack.callback(page.close)
        print(f"open {page.url} in a browser; Ctrl-C ends it", flush=True)
        browser = stack.enter_context(Browser(page.url)) if picture else None
        seen_s = 0.0

        def goes_on(t_s: float) -> bool:
            nonlocal seen_s
            seen_s = t_s
            return picture is None or t_s < shown_s

        if recording is None:
            simulate(page, Estimator(scene, args.method), args.seed, goes_on)
        else:
            play(page, Estimator(scene, args.method), recording, goes_on)
        if browser is not None:
            browser.until(f"document.body.innerText.includes('{seen_s:.1f} s')")
            browser.save(picture)
            print(f"picture: {picture}")
    return 0
