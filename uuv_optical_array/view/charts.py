"""The charts of the page: each degree of freedom, and the light, in the last minute."""

import math
from typing import Any

import numpy as np

from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, Array
from uuv_optical_array.view.sight import WINDOW_S, Window

ESTIMATE = "#5fe39a"  # on a dark ground
LEGEND = (
    "<div style='font-size:12px;padding:6px 10px'><span style='color:#ffffff'>&#9679;</span> "
    "{} &nbsp; <span style='color:{}'>&#9679;</span> three sigma{}</div>"
)
ERRORS = LEGEND.format("estimate less truth", ESTIMATE, " about 0")
ESTIMATES = LEGEND.format("estimate", ESTIMATE, "; the truth is not known")
CHART_PX = 70


class Charts:
    """Charts in the part of viser's `gui` that is open."""

    def __init__(self, gui: Any, full_scale_counts: float) -> None:
        full = math.floor(full_scale_counts)
        values = _dots("value", "#ffffff"), _dots("-3 sigma", ESTIMATE), _dots("+3 sigma", ESTIMATE)
        titles = [f"{name} ({unit})" for name, unit in zip(DOF_NAMES, DOF_UNITS, strict=True)]
        light = f"light: brightest detector (of {full:g} counts)"
        self._what = gui.add_html(ESTIMATES)
        self._charts = [_chart(gui, title, *values) for title in titles]
        self._light = _chart(gui, light, _dots("peak", "#ffd66e"), y={"range": (0.0, full)})

    def show(self, window: Window) -> None:
        """Draw what was seen."""
        what = ERRORS if window.has_truth else ESTIMATES
        if self._what.content != what:
            self._what.content = what
        for dof, chart in enumerate(self._charts):
            chart.data = _until_now(*window.bands(dof))
        self._light.data = _until_now(*window.peaks())


def _chart(gui: Any, title: str, *series: dict[str, Any], y: dict[str, Any] | None = None) -> Any:
    """Return a chart whose width is the last minute; without a range its values scale it."""
    text = {"font": "11px sans-serif", "stroke": "#c8d4e4"}
    small = {**text, "grid": {"stroke": "#ffffff18"}, "ticks": {"size": 4}}
    return gui.add_uplot(
        known(*np.zeros((1 + len(series), 0))),
        ({"label": "time (s)"}, *series),
        title=title,
        height=CHART_PX,
        padding=(8, 10, 8, 0),
        scales={"x": {"time": False, "range": (-WINDOW_S, 0.0)}, "y": y or {}},
        legend={"show": False},
        cursor={"show": False},
        axes=({"show": False}, {**small, "size": 44, "space": 11}),
    )


def _dots(label: str, colour: str) -> dict[str, Any]:
    """Return a series of dots: a line would bridge gaps."""
    points = {"show": True, "size": 2.5, "width": 0, "fill": colour}
    return {"label": label, "stroke": colour, "width": 0, "points": points}


def _until_now(t_s: Array, *values: Array) -> tuple[Array, ...]:
    """Return what a chart shows, its time before the last one, so that all have the same scale."""
    return known(t_s - t_s[-1], *values)


def known(t_s: Array, *values: Array) -> tuple[Array, ...]:
    """Return times at which all values are known, and these; nan for one, which sets no scale."""
    rows = np.stack([t_s, *values])
    rows = rows[:, np.isfinite(rows).all(axis=0)]
    if rows.shape[1] < 2:
        return (np.array([0.0, 1.0]), *np.full((len(values), 2), np.nan))
    return tuple(rows)
