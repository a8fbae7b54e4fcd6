"""``uuv_array limits``: how well one image can fix the pose at all, whoever estimates it."""

import argparse
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from uuv_optical_array.commands.parser import Subparsers, add_command, add_scene, add_shape
from uuv_optical_array.core import files
from uuv_optical_array.core.geometry import DOF_NAMES, Array
from uuv_optical_array.core.settings import Quantity, check
from uuv_optical_array.estimation.cramer_rao import cramer_rao_bound
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, load_scene
from uuv_optical_array.plots.follow import SHAPE_COLOURS, SPECIFICATION, save

DESCRIPTION = """\
The Cramer-Rao bound of a scene: the smallest standard deviation that any unbiased estimator can
reach from one image, given array, lamp, water and noise. It is printed for one pose, and drawn over
the working volume for a planar and for a curved array. What the scene's `prior` leaves uncertain,
such as the lamp's power, is estimated along with the pose and raises the bound."""

EPILOG = """\
examples:
  uuv_array limits                           6 m behind the lamp, in the default scene
  uuv_array limits --x -8 --y 0.5 --yaw-deg 10
  uuv_array limits --shape planar            the same scene with a planar array
  uuv_array limits --scene sea.yaml --output sea.png

A large condition number means that the image knows one mixture of metres and radians far better
than another: the planar array can hardly tell being aside from being turned. An angle whose bound
exceeds 180 deg is not known at all. Averaging n independent images divides a bound by sqrt(n)."""

POSE = {
    "x": Quantity("ahead of the lamp; negative is behind it", "m", -1000, 1000),
    "y": Quantity("to port", "m", -1000, 1000),
    "z": Quantity("up", "m", -1000, 1000),
    "pitch-deg": Quantity("bow down", "deg", -90, 90),
    "yaw-deg": Quantity("bow to port", "deg", -180, 180),
}
SHAPES: tuple[Shape, ...] = get_args(Shape)
IN_DEGREES = np.array([1, 1, 1, *np.degrees([1, 1])])
BEHIND_M = np.linspace(4, 8, 81)  # the working volume of Eren et al. (2016)
ASIDE_M = np.linspace(-1, 1, 81)
# What a row of the picture shows: the worst of these degrees of freedom.
ROWS = {"x, along the beam (m)": [0], "y and z, across (m)": [1, 2], "pitch and yaw (deg)": [3, 4]}
LEVELS = np.outer(10.0 ** np.arange(-3, 4), [1, 3]).ravel()


def add_parser(subparsers: Subparsers) -> None:
    """Add the subcommand."""
    parser = add_command(
        subparsers,
        "limits",
        run,
        "print and draw how well one image can fix the pose at all",
        DESCRIPTION,
        EPILOG,
    )
    add_scene(parser, "follow")
    for name, quantity in POSE.items():
        parser.add_argument(
            f"--{name}",
            type=float,
            default=-6.0 if name == "x" else 0.0,
            metavar=quantity.unit.upper(),
            help=f"{quantity.text}, {quantity.unit} (default: %(default)g)",
        )
    add_shape(parser)
    parser.add_argument(
        "--output", type=Path, default=Path("limits.png"), help="picture (default: limits.png)"
    )


def report(model: ForwardModel, pose: Array) -> str:
    """Return the bound at one pose ``(5,)``, m and rad, in words."""
    scene = model.scene
    bound = cramer_rao_bound(model, pose)
    x, y, z, pitch, yaw = pose * IN_DEGREES
    side = scene.array.detectors_per_side
    lines = [
        f"scene {scene.name}, {scene.array.shape} {side} x {side} array",
        f"pose: x {x:g}, y {y:g}, z {z:g} m; pitch {pitch:g}, yaw {yaw:g} deg",
        f"brightest reading: {model.expected(pose).max():.3g} counts",
        "",
        "least standard deviation from one image, and the specification:",
    ]
    for name, std, wanted, seen in zip(
        DOF_NAMES, bound.std * IN_DEGREES, SPECIFICATION, bound.observable, strict=True
    ):
        unit = "m" if name in "xyz" else "deg"
        verdict = "within" if std <= wanted else "beyond"
        found = f"{std:10.3g} {unit:<4} {verdict} {wanted:g} {unit}" if seen else "unobservable"
        lines.append(f"  {name:<6}{found if seen else found.rjust(15)}")
    seen_names = [name for name, seen in zip(DOF_NAMES, bound.observable, strict=True) if seen]
    lines += [
        "",
        f"observable: {', '.join(seen_names) or 'nothing'}",
        f"condition number of the information, in m and rad: {bound.condition:.2g}",
    ]
    stds = scene.prior.nuisance_std()
    if stds:
        along = ", ".join(f"{name} +-{std:g}" for name, std in stds.items())
        lines.append(f"estimated along with the pose: {along}")
    return "\n".join(lines)


def volume(model: ForwardModel) -> Array:
    """Return the bound over the working volume, m and deg, shape ``(behind, aside, 5)``."""
    poses = np.zeros((len(BEHIND_M), len(ASIDE_M), 5))
    poses[..., 0], poses[..., 1] = -BEHIND_M[:, None], ASIDE_M
    return np.stack([cramer_rao_bound(model, row).std for row in poses]) * IN_DEGREES


def _curves(axes: Axes, bounds: dict[Shape, Array], wanted: float) -> None:
    low, high = wanted / 1000, wanted * 100
    for shape, bound in bounds.items():
        shown = np.minimum(bound, 10 * high)  # what is unobservable runs out of the picture
        colour, middle = SHAPE_COLOURS[shape], shown[:, len(ASIDE_M) // 2]
        axes.fill_between(
            BEHIND_M, shown.min(axis=1), shown.max(axis=1), color=colour, alpha=0.25, lw=0
        )
        axes.plot(BEHIND_M, middle, color=colour, lw=2, label=shape)
    axes.axhline(wanted, color="k", lw=1.5, ls="--", label=f"specification, {wanted:g}")
    axes.set(yscale="log", xlim=(BEHIND_M[0], BEHIND_M[-1]), ylim=(low, high))
    axes.grid(alpha=0.4)


def _map(axes: Axes, bound: Array, wanted: float, norm: LogNorm) -> Any:
    # Where nothing is observable the hatched ground shows.
    axes.patch.set(facecolor="0.85", hatch="xx", edgecolor="0.6")
    known = np.where(np.isfinite(bound), bound, np.nan).T
    mesh = axes.pcolormesh(
        BEHIND_M, ASIDE_M, known / wanted, norm=norm, cmap="RdYlBu_r", shading="nearest"
    )
    round_levels = [level for level in LEVELS if 0.01 < level / wanted < 100 and level != wanted]
    low = known.min(initial=np.inf, where=np.isfinite(known))
    high = known.max(initial=-np.inf, where=np.isfinite(known))
    for levels, width, style in ((round_levels, 0.6, "-"), ([wanted], 2.0, "--")):
        # Matplotlib before 3.8 draws a line of its own where no level is inside.
        if inside := [level for level in levels if low < level < high]:
            lines = axes.contour(
                BEHIND_M, ASIDE_M, known, inside, colors="k", linewidths=width, linestyles=style
            )
            axes.clabel(lines, fmt="%g", fontsize=9)
    return mesh


def draw_limits(scene: Scene, path: Path) -> None:
    """Draw the bound over the working volume, for a planar and for a curved array.

    Parameters
    ----------
    scene
        The scene; its array's shape is replaced, and its lamp set anew for each.
    path
        PNG file, written whole or not at all.
    """
    stds = {shape: volume(ForwardModel(scene.with_shape(shape))) for shape in SHAPES}
    figure = Figure(figsize=(14, 10.5), layout="constrained")
    grid = figure.subplots(3, 3, sharex=True)
    norm = LogNorm(1e-2, 1e2)
    for (title, dofs), row in zip(ROWS.items(), grid, strict=True):
        wanted = float(SPECIFICATION[dofs[0]])
        bounds = {shape: std[..., dofs].max(axis=-1) for shape, std in stds.items()}
        _curves(row[0], bounds, wanted)
        row[0].set_ylabel(title, fontsize=12)
        for axes, shape in zip(row[1:], SHAPES, strict=True):
            mesh = _map(axes, bounds[shape], wanted, norm)
            axes.set(ylabel="y, port (m)", yticks=[-1, -0.5, 0, 0.5, 1])
    grid[0, 0].set_title("line: on the beam's axis; band: up to 1 m aside")
    grid[0, 0].legend(loc="upper left")
    for axes, shape in zip(grid[0, 1:], SHAPES, strict=True):
        axes.set_title(f"{shape} array, from above", color=SHAPE_COLOURS[shape])
    for axes in grid[-1]:
        axes.set_xlabel("base_link behind the lamp (m)")
    bar = figure.colorbar(mesh, ax=grid[:, 1:], extend="both", aspect=40)
    bar.set_label("bound / specification")
    bar.ax.axhline(1.0, color="k", lw=2, ls="--")
    figure.suptitle(
        f"Least standard deviation from one image (the Cramer-Rao bound), scene {scene.name}",
        fontsize=14,
    )
    save(figure, path)


def run(options: argparse.Namespace) -> int:
    """Print the bound at one pose and draw it over the working volume."""
    pose = np.array(
        [
            check(Annotated[float, quantity], getattr(options, name.replace("-", "_")), f"--{name}")
            for name, quantity in POSE.items()
        ]
    )
    scene = load_scene(options.scene)
    model = ForwardModel(scene.with_shape(options.shape or scene.array.shape))
    print(report(model, pose / IN_DEGREES))
    output = files.user_path(options.output)
    draw_limits(scene, output)
    print(f"picture: {output}")
    return 0
