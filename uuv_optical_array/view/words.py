"""What the page says of an instant, in words and numbers, as HTML."""

import math
from html import escape

import numpy as np

from uuv_optical_array.control.follow_states import COLOURS
from uuv_optical_array.control.following import State
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, IN_DEGREES
from uuv_optical_array.view.sight import Sight

FORMS = [".2f" if unit == "m" else ".1f" for unit in DOF_UNITS]


def headline(state: State | None, t_s: float, again: str = "") -> str:
    """Return what the follower does at a time, s, big and in its colour, as HTML.

    - again: what an operator does about a leader that is lost; empty: nothing here.
    """
    text, why, colour = "&nbsp;", "&nbsp;", "#ffffff"
    if state is not None:
        lasted_s = t_s - state.since_s
        text = state.name if math.isnan(lasted_s) else f"{state.name} for {max(lasted_s, 0):.0f} s"
        text = f"lost: {again}" if state.name == "lost" and again else text
        why, colour = escape(state.reason), COLOURS[state.name]
    # Two lines for why, so that what is below keeps its place.
    small = "font-size:12px;line-height:1.3;height:2.6em;overflow:hidden"
    return (
        f"<div style='padding:6px 10px 0'><b style='font-size:22px;color:{colour}'>{text}</b>"
        f"<div style='{small}'>{why}</div></div>"
    )


def words(sight: Sight, poses: int, images: int) -> str:
    """Return the numbers of an instant, as HTML, and of how many last images have a pose."""
    unknown = np.full(5, np.nan)
    pose = unknown if sight.pose is None else sight.pose * IN_DEGREES
    lines = [("estimate", pose, "+"), ("sigma", sight.stds(), "")]
    if sight.true_pose is not None:
        lines.insert(0, ("true", sight.true_pose * IN_DEGREES, "+"))
    rows = [["", *(f"{name}<br>{unit}" for name, unit in zip(DOF_NAMES, DOF_UNITS, strict=True))]]
    for name, values, sign in lines:
        numbers = zip(values, FORMS, strict=True)
        # Without an estimate its lines stay, so that what is below keeps its place.
        cells = ["&ndash;" if np.isnan(n) else f"{n:{sign}{form}}" for n, form in numbers]
        rows.append([name, *cells])
    cell = "<td style='text-align:right;padding:1px 3px'>"
    table = "".join(f"<tr>{''.join(f'{cell}{x}</td>' for x in row)}</tr>" for row in rows)
    peak = "" if sight.image is None else f"brightest detector {sight.image.max():g} counts"
    return (
        "<div style='font-size:12px;padding:6px 10px'>"
        f"<b>{sight.t_s:.1f} s</b> &nbsp; {peak}<br><table>{table}</table>"
        f"{poses} of the last {images} images have a pose<br>"
        f"<div style='min-height:2.8em;font-weight:bold;color:#ffb070'>{escape(sight.note)}</div>"
        "</div>"
    )
