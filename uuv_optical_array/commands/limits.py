"""``uuv_array limits``: show how accurately one image can determine the pose.

Compute the Cramer-Rao bound of a scene: the smallest standard deviation that any unbiased estimator
can reach from one image, given array, lamp, water and noise. The bound is printed for one pose, and
drawn over the working volume for a planar and for a curved array. What the scene's `prior` leaves
uncertain, such as the lamp's power, is estimated along with the pose and raises the bound.

  uuv_array limits                           6 m behind the lamp, in the default scene
  uuv_array limits --pose -8 0.5 0 0 10      8 m behind and 0.5 m to port, bow 10 deg to port
  uuv_array limits --shape planar            the same scene with a planar array
  uuv_array limits --scene sea.yaml --output sea.png
A large condition number means that the image determines one combination of metres and radians far
better than another: the planar array can hardly tell a lateral offset from a turn. An angle whose
bound exceeds 180 deg is unknown. Averaging n independent images divides a bound by sqrt(n).
"""

import argparse
import re
from typing import Annotated, Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array.cli import options, outputs
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, IN_DEGREES, Array, X, Y
from uuv_optical_array.core.settings import check, declared
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, TableSettings
from uuv_optical_array.forward.working_volume import RANGES_M, SPECIFICATION
from uuv_optical_array.plots.style import SHAPE_COLOURS, new_figure, save

AXES = "X", "Y", "Z", "PITCH_DEG", "YAW_DEG"
POSE = dict(zip(AXES, (axis.quantity for axis in declared(TableSettings).values()), strict=True))
BEHIND_M: Array = np.linspace(RANGES_M[0], RANGES_M[-1], 81, dtype=float)
ASIDE_M: Array = np.linspace(-1, 1, 81, dtype=float)
REACH_M = np.linspace(0.5, 25.0, 246)  # where `reach` looks
# A row of the picture shows the worst of these degrees of freedom.
ROWS = {"x, along the beam (m)": [0], "y and z, across (m)": [1, 2], "pitch and yaw (deg)": [3, 4]}
LEVELS = np.outer(10.0 ** np.arange(-3, 4), [1, 3]).ravel()


def bound_map(
    scene: Scene, behind_m: Array = BEHIND_M, aside_m: Array = ASIDE_M
) -> dict[Shape, Array]:
    """Return the bound of level poses at the lamp's depth, for each shape of the scene's array.

    Standard deviations, m and deg, ``(n, m, 5)``, inf where unobservable, at `behind_m` ``(n,)``
    and, to port, `aside_m` ``(m,)``. The lamp's power is set again for each shape.
    """
    poses = np.zeros((len(behind_m), len(aside_m), 5))
    poses[..., X], poses[..., Y] = -behind_m[:, None], aside_m
    models = {shape: ForwardModel(scene.with_shape(shape)) for shape in get_args(Shape)}
    return {
        shape: np.stack([cramer_rao_bound(model, row).std for row in poses]) * IN_DEGREES
        for shape, model in models.items()
    }


def aligned(ranges_m: ArrayLike) -> Array:
    """Return aligned poses so far behind the lamp, m, shape ``(n, 5)``."""
    return np.multiply.outer(ranges_m, [-1.0, 0.0, 0.0, 0.0, 0.0])


def within(scene: Scene, ranges_m: ArrayLike) -> NDArray[np.bool_]:
    """Say whether one image, aligned so far behind the lamp, is within the specification."""
    std = cramer_rao_bound(ForwardModel(scene), aligned(ranges_m)).std * IN_DEGREES
    return np.asarray((std <= SPECIFICATION).all(axis=1))


def reach(scene: Scene) -> tuple[float, float] | None:
    """Return the nearest and farthest range, m, where the bound of an aligned pose is as specified.

    They are about the lamp's reference range, within `REACH_M`; None where even that is beyond.
    """
    own = int(np.abs(REACH_M - scene.lamp.reference_range_m).argmin())
    beyond = np.flatnonzero(~within(scene, REACH_M))
    if own in beyond:
        return None
    first = beyond[beyond < own].max(initial=-1) + 1
    last = beyond[beyond > own].min(initial=len(REACH_M)) - 1
    return float(REACH_M[first]), float(REACH_M[last])


def report(model: ForwardModel, pose: Array) -> str:
    """Return the bound at one pose ``(5,)``, m and rad, as text."""
    scene = model.scene
    bound = cramer_rao_bound(model, pose)
    x, y, z, pitch, yaw = pose * IN_DEGREES
    side = scene.array.detectors_per_side
    lines = [
        f"scene {scene.name}, {scene.array.shape} {side} x {side} array",
        f"pose: x {x:g}, y {y:g}, z {z:g} m; pitch {pitch:g}, yaw {yaw:g} deg",
        f"brightest reading: {model.expected(pose).max():.3g} counts",
        "",
        "least standard deviation from one image, and what Eren et al. (2016) ask for:",
    ]
    names = []
    dofs = DOF_NAMES, DOF_UNITS, bound.std * IN_DEGREES, SPECIFICATION, bound.observable
    for name, unit, std, wanted, observable in zip(*dofs, strict=True):
        verdict = "within" if std <= wanted else "beyond"
        known = f"{std:10.3g} {unit:<4} {verdict} {wanted:g} {unit}"
        lines.append(f"  {name:<6}{known if observable else '   unobservable'}")
        names += [name] * bool(observable)
    lines += ["", f"observable: {', '.join(names) or 'nothing'}"]
    lines.append(f"condition number of the information, in m and rad: {bound.condition:.2g}")
    if stds := scene.nuisance_std():
        # What each of several lamps has is printed once.
        shared = {re.sub(r"^lamps\.\d+", "lamps.*", name): std for name, std in stds.items()}
        along = ", ".join(f"{name} +-{std:g}" for name, std in shared.items())
        lines.append(f"estimated along with the pose: {along}")
    return "\n".join(lines)


def draw(
    bounds: dict[Shape, Array],
    scene_name: str,
    behind_m: Array = BEHIND_M,
    aside_m: Array = ASIDE_M,
) -> Any:
    """Draw a `bound_map` of these places: along the beam, and from above for each shape."""
    from matplotlib.colors import LogNorm

    figure = new_figure(14, 10.5)
    grid = figure.subplots(3, 3, sharex=True)
    norm = LogNorm(1e-2, 1e2)
    for (title, dofs), row in zip(ROWS.items(), grid, strict=True):
        wanted = float(SPECIFICATION[dofs[0]])
        row[0].set_ylabel(title, fontsize=12)
        for axes, (shape, std) in zip(row[1:], bounds.items(), strict=True):
            worst = std[..., dofs].max(axis=-1)
            shown = np.minimum(worst, 1000 * wanted)  # what is unobservable leaves the picture
            near, far = shown.min(axis=1), shown.max(axis=1)
            colour = SHAPE_COLOURS[shape]
            row[0].fill_between(behind_m, near, far, color=colour, alpha=0.25, lw=0)
            row[0].plot(behind_m, shown[:, shown.shape[1] // 2], color=colour, lw=2, label=shape)
            mesh = _map(axes, behind_m, aside_m, worst, wanted, norm)
            axes.set(ylabel="y, port (m)", yticks=[-1, -0.5, 0, 0.5, 1])
        asked = f"Eren et al. (2016) ask for {wanted:g}"
        row[0].axhline(wanted, color="k", lw=1.5, ls="--", label=asked)
        row[0].set(yscale="log", ylim=(wanted / 1000, wanted * 100))
        row[0].set_xlim(behind_m[0], behind_m[-1])
        row[0].grid(alpha=0.4)
    grid[0, 0].set_title("line: on the beam's axis; band: up to 1 m aside")
    grid[0, 0].legend(loc="upper left")
    for axes, shape in zip(grid[0, 1:], bounds, strict=True):
        axes.set_title(f"{shape} array, from above", color=SHAPE_COLOURS[shape])
    for axes in grid[-1]:
        axes.set_xlabel("base_link behind the lamp (m)")
    bar = figure.colorbar(mesh, ax=grid[:, 1:], extend="both", aspect=40)
    bar.set_label("bound / what Eren et al. (2016) ask for")
    bar.ax.axhline(1.0, color="k", lw=2, ls="--")
    title = "Least standard deviation from one image (the Cramer-Rao bound), scene"
    figure.suptitle(f"{title} {scene_name}", fontsize=14)
    return figure


def _map(axes: Any, x: Array, y: Array, bound: Array, wanted: float, norm: Any) -> Any:
    """Draw a bound ``(n, m)`` from above; return the mesh."""
    # Where nothing is observable the hatched ground shows.
    axes.patch.set(facecolor="0.85", hatch="xx", edgecolor="0.6")
    known = np.where(np.isfinite(bound), bound, np.nan).T
    mesh = axes.pcolormesh(
        x, y, known / wanted, norm=norm, cmap="RdYlBu_r", shading="nearest", rasterized=True
    )
    round_levels = [level for level in LEVELS if 0.01 < level / wanted < 100 and level != wanted]
    low = known.min(initial=np.inf, where=np.isfinite(known))
    high = known.max(initial=-np.inf, where=np.isfinite(known))
    for levels, width, style in (([wanted], 2.0, "--"), (round_levels, 0.6, "-")):
        # Matplotlib before 3.8 draws a line of its own where no level is inside.
        if inside := [level for level in levels if low < level < high]:
            look = {"colors": "k", "linewidths": width, "linestyles": style}
            lines = axes.contour(x, y, known, inside, **look)
            axes.clabel(lines, fmt="%g", fontsize=9)
    return mesh


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "follow")
    about = "m ahead of the lamp (below 0), to port of it and above it; deg by which the follower "
    about += "is turned with the bow down, and with the bow to port"
    words: dict[str, Any] = {"nargs": 5, "default": [-6.0, 0.0, 0.0, 0.0, 0.0], "type": float}
    about += " (default: -6 0 0 0 0)"
    parser.add_argument("--pose", metavar=tuple(POSE), help=about, **words)
    options.add_shape(parser)
    outputs.add_picture(parser, "limits.png")


def run(args: argparse.Namespace) -> int:
    """Print the bound at one pose and draw it over the working volume."""
    with options.checking_options():
        for (name, quantity), value in zip(POSE.items(), args.pose, strict=True):
            check(Annotated[float, quantity], value, f"--pose {name}")
        if args.pose[X] >= 0:
            raise ValueError(f"--pose X: {args.pose[X]:g} m is not behind the lamp; give X below 0")
    scene = options.scene_of(args)
    output = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    model = ForwardModel(scene.with_shape(args.shape or scene.array.shape))
    print(report(model, np.array(args.pose) / IN_DEGREES))
    save(draw(bound_map(scene), scene.name), output)
    print(f"picture: {output}")
    return 0
