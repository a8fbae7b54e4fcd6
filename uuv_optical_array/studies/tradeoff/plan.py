"""What the trade-off measures: every method on every array and table, or some of them."""

import dataclasses
from dataclasses import dataclass

from uuv_optical_array.estimation.estimator import METHODS
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import volume_table
from uuv_optical_array.studies.tradeoff.results import Mode

# Our methods have a table of any size, the published ones what they were published with.
LOOK_UP, MOMENTS = "look_up", "moments"
PUBLISHED = (LOOK_UP, MOMENTS)
ALL_METHODS = (*PUBLISHED, *METHODS)
SIDES = (3, 5, 7, 21)
SHAPES: tuple[Shape, ...] = ("curved", "planar")
# Values along each of the five axes: 1e3, 8e3, 1e5, 1e6 and 1e7 poses.
STEPS = (4, 6, 10, 16, 25)
FRAMES: dict[Mode, int] = {"quick": 300, "full": 1000}
QUICK_STEPS, QUICK_OWN_STEPS = (10,), (4, 6, 10, 16)
QUICK_LOOK_UP_SIDE = 7
QUICK_LEAVES_OUT = (
    "left out but for --full: tables of 1e7 poses, of 1e6 but on the scene's own array, of 1e3 and "
    "8e3 on arrays of the other shape, and the look-up but on planar arrays up to 7 x 7"
)


@dataclass(frozen=True)
class Group:
    """Settings that share an array and a table, and are measured together, frame by frame in turn.

    A setting is a method, an array and the size of its table.

    Parameters
    ----------
    shape, detectors_per_side
        The array.
    steps
        Values along each axis of the table; 0 for published methods, which have their own.
    methods
        Of `ALL_METHODS`.
    """

    shape: Shape
    detectors_per_side: int
    steps: int
    methods: tuple[str, ...]

    def scene(self, scene: Scene) -> Scene:
        """Return the scene with this array, and with a table of the study's volume."""
        array = dataclasses.replace(
            scene.array.with_shape(self.shape),
            detectors_per_side=self.detectors_per_side,
            wiring=None,
        )
        table = volume_table(self.steps) if self.steps else scene.table
        return dataclasses.replace(scene, array=array, table=table)


def plan(scene: Scene, mode: Mode) -> list[Group]:
    """List what a run measures, the scene's own array first."""
    own = scene.array
    sides = sorted({*SIDES, own.detectors_per_side}, key=lambda n: (n != own.detectors_per_side, n))
    groups = []
    for shape in sorted(SHAPES, key=lambda shape: shape != own.shape):
        for side in sides:
            steps: tuple[int, ...] = STEPS
            published: tuple[str, ...] = PUBLISHED
            if mode == "quick":
                steps = QUICK_STEPS
                if shape == own.shape:
                    steps = QUICK_OWN_STEPS if side == own.detectors_per_side else STEPS[:3]
                if shape != "planar" or side > QUICK_LOOK_UP_SIDE:
                    published = (MOMENTS,)
            groups += [Group(shape, side, n, METHODS) for n in steps]
            groups += [Group(shape, side, 0, (method,)) for method in published]
    return groups
