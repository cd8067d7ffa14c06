"""The cuboid corner (C2): its image, and the corner itself for given intrinsics.

Three faces A, B, C meet in the right-angle vertex; leg A is the edge between the faces B and C, and so on cyclically.
"""

from dataclasses import dataclass

import numpy as np

from calib.geometry.pose import cross, nearest_rotation
from calib.numerics import Floats


@dataclass(frozen=True)
class Corner:
    """Three faces through `vertex` (3,), in the camera's frame.

    `legs` (3, 3): unit rows, the directions in which the edges leave the vertex; face S is spanned by the other two.
    """

    vertex: Floats
    legs: Floats

    @property
    def normals(self) -> Floats:
        """Unit normals of the faces, (3, 3) rows, each on the side of its own leg."""
        return polar(self.legs)

    @property
    def axes(self) -> Floats:
        """Right-handed orthonormal rows (3, 3) nearest to the legs: the corner's frame.

        The nearest rotation (Schönemann 1966); left-handed legs are swapped first.
        """
        return nearest_rotation(self.legs if np.linalg.det(self.legs) > 0 else self.legs[[0, 2, 1]])

    @property
    def up(self) -> Floats:
        """The leg that is most upright in the camera's image, or its opposite, pointing up there, (3,)."""
        above = np.array([0.0, -1.0, 0.0])
        steepest: Floats = self.legs[np.argmax(np.abs(self.legs @ above))]
        up: Floats = steepest * np.sign(steepest @ above)
        return up

    @property
    def angles_deg(self) -> Floats:
        """Angles between the faces (B, C), (C, A), (A, B), as dihedral angles of the corner in degrees, (3,)."""
        normals = self.normals
        cosines = np.sum(np.roll(normals, -1, axis=0) * np.roll(normals, -2, axis=0), axis=1)
        angles: Floats = 180.0 - np.degrees(np.arccos(np.clip(cosines, -1, 1)))
        return angles


@dataclass(frozen=True)
class CornerImage:
    """Image of a corner: homogeneous `vertex` (3,) and the `lines` (3, 3) that carry legs A, B, C, as unit rows."""

    vertex: Floats
    lines: Floats


def corner_image(homographies: Floats) -> CornerImage:
    """Compute the image of the corner in the first view from the faces' homographies (3, 3, 3) into the second.

    H_B⁻¹ H_C is a planar homology that fixes every point of the edge between B and C; this edge is its axis (the paper,
    section 4.2). The axis is the left eigenvector of the single eigenvalue, which is stable under noise, unlike the
    equal pair. The vertex is the least-squares intersection of the three axes. Coordinates should be normalised.
    """
    lines = []
    for a in range(3):
        homology = np.linalg.solve(homographies[(a + 1) % 3], homographies[(a + 2) % 3])
        values, left_vectors = np.linalg.eig(homology.T)
        gaps = np.abs(values[:, None] - values[None, :]).sum(axis=1)
        gaps[np.abs(values.imag) > 1e-9 * np.abs(values)] = -1.0
        line = left_vectors[:, int(np.argmax(gaps))].real
        lines.append(line / np.linalg.norm(line))
    stacked = np.stack(lines)
    return CornerImage(np.linalg.svd(stacked)[2][2], stacked)


def corner_planes(image: CornerImage, inverse_matrices: Floats, *, nearest: bool = False) -> tuple[Floats, Floats]:
    """The corner in space for trial intrinsics, both solutions: K⁻¹ (n, 3, 3) → (normals, vertex rays).

    `normals` (2, n, 3, 3): unit rows, the faces' normals in the device's frame; NaN where no real corner has this
    image. `vertex rays` (n, 3): the vertex at distance 1, z > 0. Face S is the plane normal_S · X = normal_S · vertex.

    With r the ray to the vertex and m_S ⟂ r the unit direction in the plane through r and leg S, the leg is
    c_S r + m_S. Orthogonality gives c_A c_B = −m_A · m_B and cyclically, so c_A² = −(m_A·m_B)(m_C·m_A)/(m_B·m_C).
    The two signs are the paper's concave and convex solutions (its proposition 1).

    `nearest`: where no real corner has this image, return one with a nearby image instead of NaN.
    """
    rays = inverse_matrices @ image.vertex
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    rays *= np.where(rays[:, 2:] < 0, -1.0, 1.0)
    # A line l in the image is the plane Kᵀ l through the centre; l K⁻ᵀ would be a point.
    matrices = np.linalg.inv(inverse_matrices)
    planes = np.einsum("nji,sj->nsi", matrices, image.lines)
    across = cross(planes, rays[:, None, :])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)

    products = np.sum(across[:, [1, 2, 0]] * across[:, [2, 0, 1]], axis=-1)  # m_B·m_C, m_C·m_A, m_A·m_B
    with np.errstate(invalid="ignore", divide="ignore"):
        a, b, c = products[:, 0], products[:, 1], products[:, 2]
        square = -b * c / a
        real = square > 0
        along_a = np.sqrt(np.abs(square) if nearest else square)
        along = np.stack([along_a, -c / along_a, -b / along_a], axis=-1)
    both = np.stack([along, -along])
    legs = both[..., None] * rays[None, :, None, :] + across[None]
    # The legs are mutually orthogonal, so each is the normal of the face that the other two span.
    normals: Floats = legs / np.linalg.norm(legs, axis=-1, keepdims=True)
    if nearest and not real.all():
        u, _, v = np.linalg.svd(normals[:, ~real])
        normals[:, ~real] = u @ v
    return normals, rays


def depths_on_planes(rays: Floats, normals: Floats, vertex: Floats) -> Floats:
    """z at which rays (..., 3) through z = 1 meet the planes normal · X = normal · vertex; `normals` (..., 3)."""
    depths: Floats = (normals @ vertex) / np.sum(normals * rays, axis=-1)
    return depths


def inverse_depths(normals: Floats, rays: Floats, inverse_matrices: Floats) -> Floats:
    """w (n, 3, 3), rows: the inverse depth of face S at the homogeneous image point x is w_S · x.

    For corners as of `corner_planes` with vertices along `rays` (n, 3), and K⁻¹ (n, 3, 3).
    """
    heights = np.einsum("nsi,ni->ns", normals, rays)
    inverse: Floats = np.einsum("nsi,nij->nsj", normals, inverse_matrices) / heights[..., None]
    return inverse


def polar(rows: Floats) -> Floats:
    """Return unit rows (3, 3): row i is perpendicular to the other two `rows` and on the same side as row i.

    This maps legs to the faces' normals, and normals to legs.
    """
    across = np.cross(np.roll(rows, -1, axis=0), np.roll(rows, -2, axis=0))
    across *= np.sign(np.sum(across * rows, axis=1))[:, None]
    unit: Floats = across / np.linalg.norm(across, axis=1, keepdims=True)
    return unit


def leg_signs(legs: Floats, vertex: Floats, points: Floats) -> Floats:
    """Return ±1 (3,) for each leg (3, 3 rows): the side of the vertex on which the points (N, 3) of its faces lie."""
    # Coordinates along the legs; a point on face S has two, the third being zero.
    coordinates = np.linalg.solve(legs.T, (points - vertex).T)
    signs: Floats = np.sign(np.nanmedian(np.where(np.abs(coordinates) > 1e-9, coordinates, np.nan), axis=1))
    return signs
