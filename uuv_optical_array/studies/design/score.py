"""What a design of array and lamp is worth: the paper's criterion, and the Cramer-Rao bound.

Eren et al. (2016) judge a design by whether its signature tells 0.2 m and 10 deg apart 4 to 8 m
behind the lamp, and by how few detectors that takes. docs/results/design_study.md says what each
score means.
"""

import math
from dataclasses import dataclass

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.signature.spectral_angle import spectral_angle
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import (
    MIN_PEAK_COUNTS,
    RANGES_M,
    known_volume_std,
)
from uuv_optical_array.studies.errors import position_and_angle
from uuv_optical_array.studies.separation import (
    THRESHOLD_DEG,
    WANTED,
    Conditions,
    Motion,
    angles_deg,
    from_paper_axes,
    scene_signature,
)

NOISE_DRAWS = 64
ROUNDING_DEG = 1e-9  # angles below are rounding: the converter took all noise away
BLOCK_READINGS = 1 << 14  # worked on at a time, which bounds the memory


@dataclass(frozen=True)
class Score:
    """What a design is worth.

    Parameters
    ----------
    reference_counts
        Largest reading of the lamp by the aligned array at the scene's reference range.
    shift_near_deg, yaw_near_deg
        Spectral angle of the paper's signature for 0.2 m across and for 10 deg of yaw, of either
        side the smaller one, 4 m behind the lamp, deg; nan where the aligned image is flat.
    shift_deg, yaw_deg
        The least of that at 4, 5, 6, 7 and 8 m.
    shift_near_sigmas, yaw_near_sigmas, shift_sigmas, yaw_sigmas
        The same angles over the root mean square angle by which noise moves the signature of the
        aligned array there; inf where noise moves nothing.
    position_m, angle_deg
        Root mean square bound over the working volume, that volume known: see
        `working_volume.known_volume_std`. Never more than what is known without any light.
    lit
        Share of the volume where the image peaks above `working_volume.MIN_PEAK_COUNTS`.
    lit_position_m, lit_angle_deg
        Root mean square Cramer-Rao bound of the image alone over that share; nan where it is
        nothing, inf where a pose in it is unobservable.
    """

    reference_counts: float
    shift_near_deg: float
    yaw_near_deg: float
    shift_deg: float
    yaw_deg: float
    shift_near_sigmas: float
    yaw_near_sigmas: float
    shift_sigmas: float
    yaw_sigmas: float
    position_m: float
    angle_deg: float
    lit: float
    lit_position_m: float
    lit_angle_deg: float

    @property
    def resolved_at_4m(self) -> bool:
        """Whether both moves reach the paper's threshold at 4 m, which is where it decides."""
        return min(self.shift_near_deg, self.yaw_near_deg) >= THRESHOLD_DEG

    @property
    def resolved_4_to_8m(self) -> bool:
        """Whether they do from 4 to 8 m, which is what it claims."""
        return min(self.shift_deg, self.yaw_deg) >= THRESHOLD_DEG

    @property
    def resolved(self) -> str:
        """Say where both moves reach the threshold."""
        return "4 to 8 m" if self.resolved_4_to_8m else "4 m" if self.resolved_at_4m else "none"

    @property
    def sigmas(self) -> float:
        """The lesser of `shift_sigmas` and `yaw_sigmas`."""
        return min(self.shift_sigmas, self.yaw_sigmas)


def score(scene: Scene, poses: Array, rng: np.random.Generator) -> Score:
    """Score the array and lamp of a scene.

    Parameters
    ----------
    scene
        The scene, such as `designed` returns.
    poses
        Where the bound is taken, the same for designs that are compared, shape ``(n, 5)``, n >= 1.
    rng
        Of the noise.

    Returns
    -------
    Score
        Its scores.
    """
    model = ForwardModel(scene)
    shift, yaw = (separations(scene, motion) for motion in WANTED)
    noise = np.array([signature_noise_deg(model, range_m, rng) for range_m in RANGES_M])
    noise = np.where(noise > ROUNDING_DEG, noise, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        shift_sigmas, yaw_sigmas = shift / noise, yaw / noise
    known, alone, lit = bounds(model, poses)
    position_m, angle_deg = position_and_angle(known)
    lit_position_m, lit_angle_deg = position_and_angle(alone[lit])
    return Score(
        reference_counts=scene.lamp.reference_counts,
        shift_near_deg=float(shift[0]),
        yaw_near_deg=float(yaw[0]),
        shift_deg=float(shift.min()),
        yaw_deg=float(yaw.min()),
        shift_near_sigmas=float(shift_sigmas[0]),
        yaw_near_sigmas=float(yaw_sigmas[0]),
        shift_sigmas=float(shift_sigmas.min()),
        yaw_sigmas=float(yaw_sigmas.min()),
        position_m=position_m,
        angle_deg=angle_deg,
        lit=float(lit.mean()),
        lit_position_m=lit_position_m,
        lit_angle_deg=lit_angle_deg,
    )


def separations(scene: Scene, motion: Motion) -> Array:
    """Return the spectral angle of a wanted move, of either side the smaller one, deg.

    Parameters
    ----------
    scene
        The scene.
    motion
        The move, of the size `WANTED`.

    Returns
    -------
    Array
        At each of `RANGES_M`, shape ``(5,)``.
    """
    array = scene.array
    return np.array(
        [
            angles_deg(
                scene,
                Conditions(array.shape, array.detectors_per_side, range_m, motion),
                [WANTED[motion], -WANTED[motion]],
            ).min()
            for range_m in RANGES_M
        ]
    )


def signature_noise_deg(model: ForwardModel, range_m: float, rng: np.random.Generator) -> float:
    """Return by what angle noise moves the aligned array's signature, deg, root mean square.

    Parameters
    ----------
    model
        Of the scene.
    range_m
        Of ``base_link`` behind the lamp, m.
    rng
        Of the noise.

    Returns
    -------
    float
        Over `NOISE_DRAWS` readings, from the signature of the image without noise.
    """
    pose = from_paper_axes([range_m, 0, 0, 0, 0])
    clean = model.expected(pose)
    on_axis_counts = float(clean.max())
    calm = scene_signature(clean, on_axis_counts, model.scene)
    step = _block(model)
    squares = 0.0
    for start in range(0, NOISE_DRAWS, step):
        count = min(step, NOISE_DRAWS - start)
        readings = model.expose(np.broadcast_to(pose, (count, 5)), rng)
        angles = spectral_angle(calm, scene_signature(readings, on_axis_counts, model.scene))
        squares += float((angles**2).sum())
    return math.degrees(math.sqrt(squares / NOISE_DRAWS))


def bounds(model: ForwardModel, poses: Array) -> tuple[Array, Array, Array]:
    """Bound the errors at poses.

    Returns
    -------
    known : Array
        Least standard deviation, the volume known, m and rad, shape ``(n, 5)``.
    alone : Array
        That of the image alone, the Cramer-Rao bound.
    lit : ndarray of bool
        Whether there is light, shape ``(n,)``.
    """
    known, alone, lit = np.empty_like(poses), np.empty_like(poses), np.empty(len(poses), bool)
    step = _block(model)
    for start in range(0, len(poses), step):
        part = slice(start, start + step)
        bound = cramer_rao_bound(model, poses[part])
        known[part], alone[part] = known_volume_std(bound.information), bound.std
        lit[part] = model.expected(poses[part]).max(axis=(-2, -1)) > MIN_PEAK_COUNTS
    return known, alone, lit


def _block(model: ForwardModel) -> int:
    """Return how many images are worked on at a time."""
    return max(1, BLOCK_READINGS // model.array.side**2)
