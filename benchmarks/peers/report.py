"""The figures of the comparison in words, and the picture of the search."""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from peers.libraries import OURS
from uuv_optical_array.plots.style import save

COLOURS = ["#1f6fb4", "#444444", "#8c6bb1", "#2a9d5c", "#c8401e", "#e08a00"]


def search(found: dict[str, Any]) -> str:
    """Return one table's figures in words."""
    lines = [
        "",
        f"{found['rows']:,} signatures: median time of a query, single and in a batch",
        f"  {'':18}{'single':>11} {'/ ours':>8}  {'batch':>11} {'/ ours':>8}  {'of':>5}   missed",
    ]
    for name, each in found["peers"].items():
        lines.append(
            f"  {name:18}{each['query_us']:8,.0f} us {each['ratio']:8,.1f}  "
            f"{each['batch_us']:8,.1f} us {each['batch_ratio']:8,.1f}  {each['batch_queries']:5}"
            f"   {each['missed']} of {each['checked']}"
        )
    return "\n".join(lines)


def verdicts(verdicts: dict[str, dict[str, str]]) -> str:
    """Return what each peer answers wrongly in the hard cases."""
    lines = ["", "wrong in hard cases, on 10,000 signatures"]
    for name, words in verdicts.items():
        wrong = [f"{what}: {said}" for what, said in words.items() if not said.startswith("right")]
        lines.append(f"  {name:18}{'; '.join(wrong) or 'nothing'}")
    return "\n".join(lines)


def light(found: dict[str, Any]) -> str:
    """Return the simulation's figures in words."""
    lines = [
        "",
        f"{found['poses']:,} random poses of {found['detectors']} detectors; "
        f"the floor is np.exp of as many readings: {found['floor_s'] * 1e3:.0f} ms",
        f"  {'':18}{'poses per s':>12} {'x floor':>9}",
    ]
    each = found["numpy"]
    lines.append(f"  {'NumPy':18}{each['poses_per_s']:12,.0f} {each['times_floor']:9.1f}")
    return "\n".join(lines)


def draw(searches: list[dict[str, Any]], path: Path) -> None:
    """Draw the time of a query against the rows, single and in a batch, by peer."""
    figure = Figure(figsize=(12, 5.6), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for axes, key, title in zip(
        panels, ("query_us", "batch_us"), ("single query", "query of a batch"), strict=True
    ):
        for name, colour in zip(searches[0]["peers"], COLOURS, strict=False):
            rows = [found["rows"] for found in searches]
            each = [found["peers"][name] for found in searches]
            us = [one[key] for one in each]
            axes.plot(rows, us, color=colour, label=name, lw=2.5 if name == OURS else 1.3)
            for exact, style in (
                (True, {"marker": "o", "ms": 7}),
                (False, {"marker": "x", "ms": 9, "mew": 2}),
            ):
                chosen = [i for i, one in enumerate(each) if one["exact"] == exact]
                marked = [rows[i] for i in chosen], [us[i] for i in chosen]
                axes.plot(*marked, ls="", color=colour, **style)
        axes.set(xscale="log", yscale="log", title=title, xlabel="signatures in the table")
        axes.grid(which="major", alpha=0.4)
    panels[0].set_ylabel("median time of a query (us)")
    panels[1].legend(loc="upper left", fontsize=9)
    figure.suptitle(
        "Search by spectral angle. Cross: some query was answered wrongly, or not refused,\n"
        "of angles that are tiny, numbers that are huge, or vectors of zeros"
    )
    save(figure, path)
