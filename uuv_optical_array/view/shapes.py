"""The meshes of vehicles and beam, and the ellipsoid of a position."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.geometry import Array, rotation_matrix
from uuv_optical_array.forward.lamp.beam import angle_of, gaussians_of
from uuv_optical_array.forward.lamp.lamps import AXIS_PITCH, PLACE_X, SHARE, SIGMA, lamps_in_numbers
from uuv_optical_array.forward.scene import Scene

SIDES = 32  # of a mesh that is round
Mesh: TypeAlias = tuple[Array, NDArray[np.int64]]  # vertices and faces, ``(n, 3)`` and ``(m, 3)``


def ellipsoid(covariance: Array, turn: Array) -> tuple[Array, Array]:
    """Return half axes and rotation of the 3 sigma ellipsoid of a position in ``beacon``.

    The rotation is from its axes to the frame of the drawing, which `turn` rotates to ``beacon``.
    """
    variances, axes = np.linalg.eigh(turn.T @ covariance @ turn)
    axes[:, 0] *= np.linalg.det(axes)  # a rotation, no reflection
    return 3 * np.sqrt(np.maximum(variances, 0.0)), axes


def _revolved(along: Array, radius: Array) -> Mesh:
    """Return a surface of revolution about x."""
    angle = np.linspace(0, 2 * np.pi, SIDES, endpoint=False)
    ring = np.stack([np.zeros(SIDES), np.cos(angle), np.sin(angle)], axis=1)
    vertices = (ring * radius[:, None, None]) + np.array([1.0, 0, 0]) * along[:, None, None]
    i, k = np.meshgrid(np.arange(len(along) - 1), np.arange(SIDES), indexing="ij")
    here, beside = i * SIDES + k, i * SIDES + (k + 1) % SIDES
    faces = np.stack([[here, beside, here + SIDES], [beside, beside + SIDES, here + SIDES]])
    return vertices.reshape(-1, 3), np.moveaxis(faces, 1, -1).reshape(-1, 3)


def body(half_m: float) -> dict[str, Mesh]:
    """Return a hull, `half_m` ahead and astern of ``base_link``, and a fin upright at its stern."""
    radius_m, angle = 0.35 * half_m, np.linspace(-np.pi / 2, np.pi / 2, 12)
    along = np.sin(angle) * radius_m + np.sign(angle) * (half_m - radius_m)
    corners = np.array([[-1.0, 0, 0], [-0.4, 0, 0], [-0.75, 0, 0.85], [-1.0, 0, 0.85]])
    fin = corners * half_m, np.array([[0, 1, 2], [0, 2, 3]])
    return {"hull": _revolved(along, np.cos(angle) * radius_m), "fin": fin}


def beams(scene: Scene, length_m: float) -> list[tuple[Array, list[Mesh]]]:
    """Return of each lamp its place and its beam out to one and two of its standard deviations.

    One of several Gaussians ends where it is as dark as a single one is there.
    """
    edges = [angle_of(gaussians_of(scene.lamp), stds) for stds in (1, 2)]
    lamps = lamps_in_numbers(scene.lamps, np.radians(scene.lamp.beam_sigma_deg))
    found = []
    for lamp in lamps.T:
        place, turn = lamp[PLACE_X:AXIS_PITCH], rotation_matrix(*lamp[AXIS_PITCH:SHARE])
        wide = (np.tan(min(edge * lamp[SIGMA], 1.4)) for edge in edges)
        cones = (_revolved(np.array([0, -length_m]), np.array([0, length_m * x])) for x in wide)
        found.append((place, [(vertices @ turn.T + place, faces) for vertices, faces in cones]))
    return found
