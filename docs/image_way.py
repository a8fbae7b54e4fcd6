"""The way of one image to its pose, as SVG, for ``docs/generate_reference.py``.

Each panel shows what one module of the estimation makes of the image, computed by that module.
"""

from collections.abc import Callable, Sequence

import numpy as np
from drawings import GREY, INK, LIGHT, arrow, dot, line, picture, words
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array import Estimator, ForwardModel, load_scene
from uuv_optical_array.core.numerics.gauss_newton import first_damping
from uuv_optical_array.estimation.estimate import Estimate
from uuv_optical_array.estimation.least_squares.attitude_nodes import new_lattice
from uuv_optical_array.estimation.least_squares.frame_kinds import frame_kinds
from uuv_optical_array.estimation.least_squares.image_fit import pose_prior
from uuv_optical_array.estimation.least_squares.posterior import integrate
from uuv_optical_array.estimation.least_squares.problem import (
    MOST_STEPS,
    Problem,
    evaluate,
    propose,
    start_at,
    step,
)
from uuv_optical_array.estimation.least_squares.starts import (
    Guide,
    direction,
    guide_of,
    nearest_rows,
)
from uuv_optical_array.forward.prior import shade_modes

TRUTH = np.array([-5.0, 0.6, -0.3, 0.12, -0.1])  # m and rad
STARTS, DRAWN = 3, 400  # starts of the fit, and poses drawn of those that they are chosen from
SHADES = 0.0, 0.01, 0.02, 0.04  # root mean square of a smooth shade
WIDTH, HEIGHT, GAP = 330, 246, 36  # of a panel, px
INNER = 190  # height of what a panel shows
COLOURS = "#c0392b", "#2471a3", "#1e8449"
Point = Callable[[ArrayLike], NDArray[np.float64]]


def axes(left: float, top: float, low: ArrayLike, high: ArrayLike, names: Sequence[str]):
    """Return a frame with names and ends of its axes, and what places points in it."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    corner, size = np.array([left + 58, top + 34]), np.array([WIDTH - 76, INNER - 34])

    def place(points: ArrayLike) -> NDArray[np.float64]:
        share = (np.asarray(points, dtype=float) - low) / (high - low)
        return corner + size * np.stack([share[..., 0], 1 - share[..., 1]], axis=-1)

    (x, y), (w, h) = corner, size
    parts = [line([[x, y], [x, y + h], [x + w, y + h], [x + w, y]], True, stroke=GREY)]
    small = {"font_size": 12, "fill": GREY}
    parts += [
        words(x, y + h + 15, f"{low[0]:g}", **small),
        words(x + w, y + h + 15, f"{high[0]:g}", text_anchor="end", **small),
        words(x + w / 2, y + h + 15, names[0], text_anchor="middle", **small),
        words(x - 5, y + h, f"{low[1]:g}", text_anchor="end", **small),
        words(x - 5, y + 10, f"{high[1]:g}", text_anchor="end", **small),
        words(x - 5, y + h / 2 + 4, names[1], text_anchor="end", **small),
    ]
    return parts, place


def cross(at: NDArray[np.float64]) -> list[str]:
    """Return the mark of what is true."""
    x, y = at
    return [
        line([[x - 6, y - 6], [x + 6, y + 6]], stroke_width=2),
        line([[x - 6, y + 6], [x + 6, y - 6]], stroke_width=2),
    ]


def ellipse(place: Point, mean: ArrayLike, covariance: NDArray[np.float64], stds: float) -> str:
    """Return the ellipse of a Gaussian at so many standard deviations."""
    round_ = np.linspace(0, 2 * np.pi, 49)
    circle = stds * np.stack([np.cos(round_), np.sin(round_)], axis=-1)
    points = np.asarray(mean) + circle @ np.linalg.cholesky(covariance).T
    return line(place(points), True, stroke=COLOURS[1], stroke_width=1.5)


def readings(left: float, top: float, image: NDArray[np.float64]) -> list[str]:
    """Return the image, counts."""
    cell, parts = (INNER - 20) / len(image), []
    x0 = left + (WIDTH - cell * len(image)) / 2
    for (row, column), value in np.ndenumerate(image):
        x, y, grey = x0 + cell * column, top + 30 + cell * row, round(255 * value / image.max())
        square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * cell + [x, y]
        parts.append(line(square, True, fill=f"rgb({grey},{grey},{grey})", stroke=GREY))
        ink = INK if grey > 128 else "white"
        middle = x + cell / 2, y + cell / 2 + 4
        parts.append(words(*middle, f"{value:.0f}", text_anchor="middle", fill=ink, font_size=12))
    return parts


def alike(left: float, top: float, guide: Guide, rows: NDArray[np.intp]) -> list[str]:
    """Return the poses of like signature among those that a fit may start from."""
    parts, place = axes(left, top, (-8.5, -1.5), (-1.5, 1.5), ("x (m)", "y (m)"))
    points = guide.poses[:DRAWN, :2]
    parts += [dot(*place(point), 1.6, fill="#bbb") for point in points]
    for row, colour in zip(rows, COLOURS, strict=True):
        parts.append(dot(*place(guide.poses[row, :2]), 6, fill=colour))
    return parts + cross(place(TRUTH[:2]))


def descents(problem: Problem, guide: Guide, rows: NDArray[np.intp]):
    """Return the states of the fit from each start, and the best of the last ones."""
    paths = []
    for row in rows:
        states = [evaluate(problem, start_at(problem, guide.poses[row]))]
        damping = first_damping(states[0])
        while damping > 0 and len(states) < MOST_STEPS:
            proposed = propose(problem, states[-1], damping)
            state, damping = step(problem, states[-1], proposed, damping)
            states.append(state)
        paths.append(states)
    return paths, min((states[-1] for states in paths), key=lambda state: state.cost)


def costs(left: float, top: float, paths: Sequence[Sequence], least: float) -> list[str]:
    """Return how the cost falls from each start."""
    longest = max(len(states) for states in paths) - 1
    parts, place = axes(left, top, (0, -3), (longest, 4), ("steps", "log cost"))
    for states, colour in zip(paths, COLOURS, strict=True):
        above = [np.log10(max(state.cost - least, 1e-3)) for state in states]
        points = place(np.stack([np.arange(len(above)), np.clip(above, -3, 4)], axis=-1))
        parts.append(line(points, stroke=colour, stroke_width=2))
        parts += [dot(*point, 3, fill=colour) for point in points]
    return parts


def attitudes(left: float, top: float, problem: Problem, minimum) -> list[str]:
    """Return the posterior of the attitude at the nodes by which it is integrated."""
    lattice = new_lattice(len(minimum.at))
    integrate(problem, minimum, lattice)
    nodes = np.degrees(lattice.poses[:, 3:])[lattice.logs > -np.inf]
    logs = lattice.logs[lattice.logs > -np.inf]
    low, high = np.floor(nodes.min(axis=0) - 1), np.ceil(nodes.max(axis=0) + 1) + 0.0
    parts, place = axes(left, top, low, high, ("pitch (deg)", "yaw"))
    sizes = 9 * np.exp(0.25 * (logs - logs.max()))
    for node, size in zip(nodes, sizes, strict=True):
        parts.append(dot(*place(node), round(float(size), 1), fill=COLOURS[1]))
    return parts + cross(place(np.degrees(TRUTH[3:])))


def clearness(left: float, top: float, estimates: Sequence[Estimate]) -> list[str]:
    """Return how probable a clear image is, and the range's standard deviation, by a shade."""
    parts, y = [], top + 52
    for text, x in (("shade", 20), ("probability of a clear image", 72), ("std of x", 268)):
        parts.append(words(left + x, top + 34, text, font_size=12, fill=GREY))
    for shade, estimate in zip(SHADES, estimates, strict=True):
        corner, bar = np.array([left + 72, y]), np.array([[0, 0], [180, 0], [180, 18], [0, 18]])
        parts.append(line(corner + bar, True, fill=LIGHT, stroke="none"))
        parts.append(
            line(
                (bar - bar[0]) * [estimate.clear, 1] + bar[0], True, fill=COLOURS[2], stroke="none"
            )
        )
        std = float(np.sqrt(estimate.covariance[0, 0]))
        parts += [
            words(left + 20, y + 14, f"{100 * shade:g} %", font_size=13),
            words(left + 268, y + 14, f"{std:.2f} m", font_size=13),
        ]
        y += 36
    return parts


def estimated(left: float, top: float, estimate: Estimate) -> list[str]:
    """Return the estimate with ellipses of one and two standard deviations."""
    half = np.array([0.75, 0.4])
    low, high = TRUTH[:2] - half, TRUTH[:2] + half
    parts, place = axes(left, top, low.round(2), high.round(2), ("x (m)", "y (m)"))
    covariance = estimate.covariance[:2, :2]
    parts += [ellipse(place, estimate.pose[:2], covariance, stds) for stds in (1, 2)]
    return [*parts, dot(*place(estimate.pose[:2]), 4, fill=COLOURS[1]), *cross(place(TRUTH[:2]))]


def image_way() -> str:
    """Return the drawing of the way of one image."""
    scene = load_scene("follow")
    model, estimator = ForwardModel(scene), Estimator(scene).wait()
    seen = [shaded(model, shade) for shade in SHADES]
    estimates = [estimator.estimate(image) for image in seen]
    guide = guide_of(model, STARTS, np.inf)
    problem = frame_kinds(model, *pose_prior(scene))[0].problem._replace(readings=seen[0].ravel())
    rows, _ = nearest_rows(guide.units, direction(problem.readings, guide), STARTS)
    paths, minimum = descents(problem, guide, rows)
    panels = (
        ("1  An image, counts", "forward/model.py", readings, (seen[0],)),
        ("2  Poses of like signature", "least_squares/starts.py", alike, (guide, rows)),
        ("3  The fit from each, to one minimum", "least_squares/problem.py, frame.py", costs,
         (paths, minimum.cost)),
        ("4  The posterior about it", "least_squares/posterior.py", attitudes, (problem, minimum)),
        ("5  Or is the light uneven?", "least_squares/frame_kinds.py", clearness, (estimates,)),
        ("6  Pose and covariance", "least_squares/image_fit.py", estimated, (estimates[0],)),
    )  # fmt: skip
    parts = []
    for number, (title, module, draw, of) in enumerate(panels):
        row, column = divmod(number, 3)
        left, top = 20 + (WIDTH + GAP) * column, 20 + (HEIGHT + GAP) * row
        parts.append(words(left + 10, top + 8, title, font_weight="bold"))
        parts += draw(left, top, *of)
        parts.append(words(left + 10, top + HEIGHT - 18, module, fill=GREY, font_size=13))
        if column < 2:
            y = top + INNER / 2 + 14
            parts.append(arrow([left + WIDTH + 2, y], [left + WIDTH + GAP - 4, y], stroke_width=2))
    bottom = 20 + 2 * (HEIGHT + GAP) - 14
    parts += [
        *cross(np.array([36.0, bottom - 5])),
        words(50, bottom, "the true pose", font_size=13),
    ]
    return picture(40 + 3 * WIDTH + 2 * GAP, bottom + 16, parts)


def shaded(model: ForwardModel, shade: float) -> NDArray[np.float64]:
    """Return what the array reads at `TRUTH`, under a smooth shade."""
    light = model.expected(TRUTH)
    dimmed = light * np.exp(shade * shade_modes(len(light))[4].reshape(light.shape))
    return np.asarray(np.rint(dimmed + np.random.default_rng(4).normal(0, 1, light.shape)))
