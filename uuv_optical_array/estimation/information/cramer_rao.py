"""The physical limit: how well one image of a scene can fix the pose at all.

The Fisher information of an image is ``J' diag(w) J``, with the Jacobian J of the light by the
pose and the information w of one reading about its light (S. Kay, Estimation Theory, 1993, ch. 3).
No unbiased estimator that sees one image has a covariance below its inverse, the Cramer-Rao bound.
Everything is in m and rad, so the condition number compares a metre with a radian.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array.core.errors import expect
from uuv_optical_array.core.geometry import Array, turned_with_beam
from uuv_optical_array.estimation.information.likelihood import information
from uuv_optical_array.forward.aim import aim_slopes
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import ROLL

# An eigenvalue this small beside the largest is what rounding leaves of zero.
ROUNDING = 1e-13
# A direction that is known to no better than this many m and rad is not seen at all,
NOTHING_KNOWN = 1e6
# and a degree of freedom is unobservable with more than this share in such a direction.
SHARE = 1e-6


@dataclass(frozen=True)
class Bound:
    """The Cramer-Rao bound at poses of shape ``(..., 5)``, in m and rad.

    The bound is local: a standard deviation beyond half a turn says that the angle is unknown.

    - information: Fisher's, of x, y, z, pitch and yaw, shape ``(..., 5, 5)``.
    - covariance: its inverse, with what the aim of lamp and array adds, shape ``(..., 5, 5)``. An
      unobservable degree of freedom has the variance inf and covariances nan; the block of the
      others is exact, not that of a pseudo-inverse.
    - observable: whether the image says anything of a degree of freedom, shape ``(..., 5)``.
    - condition: condition number of `information`, >= 1, shape ``(...)``; inf where singular.
    """

    information: Array
    covariance: Array
    observable: NDArray[np.bool_]
    condition: Array

    @property
    def std(self) -> Array:
        """Least standard deviation of each degree of freedom, m and rad, shape ``(..., 5)``."""
        return np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))


def fisher_information(model: ForwardModel, poses: ArrayLike, roll: ArrayLike = 0.0) -> Array:
    """Fisher information of one image about the pose.

    What the scene's prior leaves uncertain, such as the lamp's power, counts as estimated along
    under that prior: its share is taken off by the Schur complement. The pose has no prior.

    - poses, roll: in ``beacon``, m and rad, ``(..., 5)``; roll, known, broadcast to ``(...)``.
    - returned: positive semidefinite but for rounding, shape ``(..., 5, 5)``. At the edge where a
      detector turns away from the lamp the side without light is taken.
    - ValueError: for a pose that is not finite.
    """
    expect(model, ForwardModel, "model", "ForwardModel(scene)")
    poses = np.asarray(poses, dtype=float)
    if not np.isfinite(poses).all():
        raise ValueError("poses: not finite; give metres and radians")
    stds = model.scene.nuisance_std()
    offsets = {name: np.zeros(poses.shape[:-1]) for name in stds}
    light, jacobian = model.linearised(poses, roll, offsets)
    if ROLL in stds:
        # At a given pose: the light is that of one turned back about the beam.
        by_roll = jacobian[..., :5] @ turned_with_beam(poses)[..., None]
        jacobian[..., 5 + list(stds).index(ROLL)] -= by_roll[..., 0]
    # What is too small for a float64 tells nothing.
    with np.errstate(under="ignore"):
        weights = information(light, model.noise)
        joint = np.swapaxes(jacobian, -1, -2) * weights[..., None, :] @ jacobian
        of_pose, cross, of_nuisances = joint[..., :5, :5], joint[..., :5, 5:], joint[..., 5:, 5:]
        if not stds:
            return of_pose
        of_nuisances = of_nuisances + np.diag(1 / np.square(list(stds.values())))
        return of_pose - cross @ np.linalg.solve(of_nuisances, np.swapaxes(cross, -1, -2))


def cramer_rao_bound(model: ForwardModel, poses: ArrayLike, roll: ArrayLike = 0.0) -> Bound:
    """Bound the covariance of every unbiased estimator of the pose that sees one image.

    Parameters
    ----------
    model, poses, roll
        As in `fisher_information`.

    Returns
    -------
    Bound
        In every direction finite or marked; never an error for a pose without light.

    Raises
    ------
    ValueError
        For a pose that is not finite.
    """
    fisher = fisher_information(model, poses, roll)
    with np.errstate(under="ignore"):
        values, vectors = np.linalg.eigh(fisher)
        largest = values[..., -1:]
        seen = values > np.maximum(ROUNDING * largest, NOTHING_KNOWN**-2)
        inverse = np.divide(1.0, values, out=np.zeros_like(values), where=seen)
        covariance = (vectors * inverse[..., None, :]) @ np.swapaxes(vectors, -1, -2)
        observable = ((np.abs(vectors) < SHARE) | seen[..., None, :]).all(axis=-1)
    # As a prior vanishes, variances in an unseen direction, and of all with a part in it, diverge.
    covariance[~(observable[..., :, None] & observable[..., None, :])] = np.nan
    diagonal = np.arange(5)
    variance = covariance[..., diagonal, diagonal]
    covariance[..., diagonal, diagonal] = np.where(observable, variance, np.inf)
    if not model.scene.prior.aimed:
        flat = np.asarray(poses, dtype=float).reshape(-1, 5)
        rolls = np.broadcast_to(roll, variance.shape[:-1]).reshape(-1)
        aim = [aim_slopes(model.scene, *at) for at in zip(flat, rolls.tolist(), strict=True)]
        slopes = np.array(aim).reshape(*variance.shape, -1)
        covariance += slopes @ np.swapaxes(slopes, -1, -2)
    condition = np.full(largest.shape, np.inf)
    np.divide(largest, values[..., :1], out=condition, where=seen[..., :1])
    return Bound(fisher, covariance, observable, condition[..., 0])
