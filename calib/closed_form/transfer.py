"""Camera intrinsics → projector intrinsics through the corner, and back: the paper's sections 3.2 and 4.1, batched; and
the resection of a device.

A trial costs a 12 × 12 eigenproblem, whatever the number of matches: a point on face S with image x is B_S x with B_S =
[K⁻¹; nᵀK⁻¹/d], so the normal matrix of the projector's DLT is Σ_S (I ⊗ B_S) G_S (I ⊗ B_Sᵀ) with the Gram matrix G_S of
the face's homography.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from calib.geometry import CornerImage, FaceGrams, Pose, corner_image, corner_planes, homogeneous, inverse_depths
from calib.numerics import Floats, compiled, normalisation

# Of the largest eigenvalue, and over the smallest one: less, and points on one plane leave the device open.
_TOLD, _OVER_NOISE = 1e-9, 30.0


@dataclass(frozen=True)
class Transfer:
    """The second device for each of n trial intrinsics of the first; NaN where the trial has no solution.

    `matrix` (n, 3, 3): K with skew and unequal focals, as the DLT gives it; `rotation` (n, 3, 3), `translation` (n, 3):
    X_second = R X_first + t, with the vertex at distance 1 from the first device; `normals` (n, 3, 3), `vertex` (n, 3):
    the corner in the first device's frame. `inverse_depths` (n, 3, 3): rows whose product with a homogeneous image
    point of each face is its inverse depth in the first device. `second_depths` (n, 3, 3): rows whose product is the
    point's depth in the second device times its inverse depth in the first.
    """

    matrix: Floats
    rotation: Floats
    translation: Floats
    normals: Floats
    vertex: Floats
    inverse_depths: Floats
    second_depths: Floats

    def __getitem__(self, chosen: slice) -> "Transfer":
        return Transfer(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def in_front(self, points: Sequence[Floats]) -> Floats:
        """Share (n,) of homogeneous image points (N, 3), per face, that lie in front of both devices."""
        return share_in_front(self.inverse_depths, self.second_depths, points)


def share_in_front(inverse_depths: Floats, second_depths: Floats, points: Sequence[Floats]) -> Floats:
    """Like `Transfer.in_front`, from the depth rows (n, 3, 3); only the signs of their products matter."""
    in_front = [
        (inverse_depths[:, face] @ x.T > 0) & (second_depths[:, face] @ x.T > 0) for face, x in enumerate(points)
    ]
    share: Floats = np.concatenate(in_front, axis=1).mean(axis=1)
    return share


def image_of_corner(grams: FaceGrams) -> CornerImage:
    """The corner's image in the first device of `grams`, in pixels."""
    scaled = FaceGrams(grams.to_projector, grams.to_camera, np.eye(3), np.eye(3))
    image = corner_image(scaled.homographies())
    vertex = np.asarray(np.linalg.solve(grams.camera_scale, image.vertex), np.float64)
    lines = image.lines @ grams.camera_scale
    lines /= np.linalg.norm(lines, axis=1, keepdims=True)
    return CornerImage(vertex, lines)


def transfer(grams: FaceGrams, image: CornerImage, matrices: Floats, *, nearest: bool = False) -> Transfer:
    """Transfer trial intrinsics (n, 3, 3) of the first device of `grams`; n results for each of the two corners: 2n.

    The first n results belong to one solution of the corner, the others to its mirror (concave and convex). With
    `nearest`, trials without an exact corner use the one whose image comes nearest.
    """
    inverses = np.asarray(np.linalg.inv(matrices), np.float64)
    normals, rays = corner_planes(image, inverses, nearest=nearest)
    count = 2 * len(matrices)
    normals = normals.reshape(count, 3, 3)
    rays, inverses = np.concatenate([rays, rays]), np.concatenate([inverses, inverses])
    with np.errstate(invalid="ignore", divide="ignore"):
        weights = inverse_depths(normals, rays, inverses)
    embed = np.concatenate([np.broadcast_to(inverses[:, None], (count, 3, 3, 3)), weights[:, :, None, :]], axis=2)
    embed = embed @ np.linalg.inv(grams.camera_scale)

    normal_matrix = np.empty((count, 12, 12))
    _normal_matrices(embed, grams.to_projector, normal_matrix)
    solved = np.isfinite(normal_matrix).all(axis=(1, 2))
    motion = np.full((count, 3, 4), np.nan)
    motion[solved] = np.linalg.eigh(normal_matrix[solved])[1][:, :, 0].reshape(-1, 3, 4)
    matrix, rotation, translation = decompose(np.linalg.inv(grams.projector_scale) @ motion)
    ahead = np.einsum("ni,nij->nj", rotation[:, 2], inverses)
    in_second = ahead[:, None] + translation[:, 2, None, None] * weights
    return Transfer(matrix, rotation, translation, normals, rays, weights, in_second)


@compiled
def _normal_matrices(embed: Floats, grams: Floats, normal_matrices: Floats) -> None:
    """Σ_S (I ⊗ B_S) G_S (I ⊗ B_Sᵀ) of each trial's B_S (n, 3, 4, 3) and the Gram matrices (3, 9, 9) → (n, 12, 12)."""
    half = np.empty((4, 3))
    for trial in range(len(embed)):
        normal_matrices[trial] = 0.0
        for face in range(3):
            b = embed[trial, face]
            for row in range(3):
                for column in range(3):
                    g = grams[face, 3 * row : 3 * row + 3, 3 * column : 3 * column + 3]
                    for i in range(4):
                        for j in range(3):
                            half[i, j] = b[i, 0] * g[0, j] + b[i, 1] * g[1, j] + b[i, 2] * g[2, j]
                    block = normal_matrices[trial, 4 * row : 4 * row + 4, 4 * column : 4 * column + 4]
                    for i in range(4):
                        for j in range(4):
                            block[i, j] += half[i, 0] * b[j, 0] + half[i, 1] * b[j, 1] + half[i, 2] * b[j, 2]


def decompose(motion: Floats) -> tuple[Floats, Floats, Floats]:
    """Camera matrices (n, 3, 4) → K (n, 3, 3) with positive focals, R (n, 3, 3), t (n, 3).

    A Aᵀ = K Kᵀ for A = K R gives K in closed form, row by row from below (Hartley & Zisserman, section 6.2.4).
    """
    linear = motion[:, :, :3]
    with np.errstate(invalid="ignore", divide="ignore"):
        motion = motion / (np.cbrt(np.linalg.det(linear)))[:, None, None]
        linear = motion[:, :, :3]
        square = linear @ linear.transpose(0, 2, 1)
        scale = np.sqrt(square[:, 2, 2])
        square = square / square[:, 2:, 2:]
        x0, y0 = square[:, 0, 2], square[:, 1, 2]
        fy = np.sqrt(square[:, 1, 1] - y0**2)
        skew = (square[:, 0, 1] - x0 * y0) / fy
        fx = np.sqrt(square[:, 0, 0] - skew**2 - x0**2)
    zero, ones = np.zeros_like(x0), np.ones_like(x0)
    matrix = np.stack([fx, skew, x0, zero, fy, y0, zero, zero, ones], axis=-1).reshape(-1, 3, 3)
    placed = np.full(motion.shape, np.nan)
    solved = np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(motion).all(axis=(1, 2))
    placed[solved] = np.linalg.solve(matrix[solved], motion[solved]) / scale[solved, None, None]
    return matrix, placed[:, :, :3].copy(), placed[:, :, 3].copy()


def intrinsic_matrices(focal_px: Floats, principal_point_px: tuple[float, float] | Floats) -> Floats:
    """K (n, 3, 3) of square pixels for focals (n,) and one principal point, or as many (n, 2)."""
    matrices = np.zeros((len(focal_px), 3, 3))
    matrices[:, 0, 0] = matrices[:, 1, 1] = focal_px
    matrices[:, :2, 2] = principal_point_px
    matrices[:, 2, 2] = 1.0
    return matrices


def resected(points: Floats, pixels: Floats) -> tuple[Floats, Pose] | None:
    """The matrix (3, 3) of a device without lens that sees points (N, 3) at pixels (N, 2), and the pose from their
    frame into its own; None of points on one plane, or behind it.
    """
    scale, centre = normalisation(pixels), points.mean(axis=0)
    spread = float(np.sqrt(np.mean(np.sum((points - centre) ** 2, axis=1))))
    ideal = homogeneous(pixels) @ scale.T
    solid = homogeneous((points - centre) / spread)
    rows = np.zeros((2 * len(points), 12))
    rows[0::2, 0:4], rows[0::2, 8:12] = solid, -ideal[:, :1] * solid
    rows[1::2, 4:8], rows[1::2, 8:12] = solid, -ideal[:, 1:2] * solid
    values, vectors = np.linalg.eigh(rows.T @ rows)
    if values[1] < max(_TOLD * values[-1], _OVER_NOISE * values[0]):
        return None
    before = np.linalg.inv(scale) @ vectors[:, 0].reshape(3, 4)
    matrix, rotation, translation = (part[0] for part in decompose(before[None]))
    pose = Pose(rotation, spread * translation - rotation @ centre)
    depths = points @ rotation[2] + pose.translation[2]
    return (matrix, pose) if np.isfinite(rotation).all() and np.median(depths) > 0 else None
