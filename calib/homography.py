"""Plane-induced homographies and their Gram matrices.

The normal matrix of a face's homography DLT is all that the paper's algorithm needs of the matches on that face:
it is accumulated once, and a search costs the same for a hundred matches as for a million.
"""

from dataclasses import dataclass

import numpy as np

from calib.arrays import Floats
from calib.matches import Matches
from calib.parallel import in_parallel

FACES = (0, 1, 2)
_CHUNK = 1 << 15


class TooFewMatchesError(ValueError):
    """A face has too few matches to determine its homography."""


def homogeneous(points: Floats) -> Floats:
    """(..., 2) → (..., 3) with a one behind."""
    return np.concatenate([points, np.ones_like(points[..., :1])], axis=-1)


def dehomogenise(points: Floats) -> Floats:
    """(..., 3) → (..., 2)."""
    inhomogeneous: Floats = points[..., :2] / points[..., 2:]
    return inhomogeneous


def normalisation(points: Floats) -> Floats:
    """Similarity (3, 3) that takes points (N, 2) to mean 0 and mean length √2 (Hartley 1997)."""
    centre = points.mean(axis=0)
    length = np.linalg.norm(points - centre, axis=1).mean()
    scale = np.sqrt(2) / length if length > 0 else 1.0
    return np.array([[scale, 0.0, -scale * centre[0]], [0.0, scale, -scale * centre[1]], [0.0, 0.0, 1.0]])


def dlt_gram(source: Floats, target: Floats) -> Floats:
    """Normal matrix (9, 9) of the DLT for H with target ~ H source; points (N, 2), both normalised. Divided by N."""
    return _gram_of_moments(_moments(source, target))


def _moments(source: Floats, target: Floats) -> Floats:
    """Mean of x_i u_a x_j u_b over matches of homogeneous points x and u, (3, 3, 3, 3) in the order i, a, j, b."""
    moments = np.zeros((9, 9))
    for start in range(0, len(source), _CHUNK):
        part = slice(start, start + _CHUNK)
        x, u = homogeneous(source[part]), homogeneous(target[part])
        products = (x[:, :, None] * u[:, None, :]).reshape(-1, 9)
        moments += products.T @ products
    return (moments / len(source)).reshape(3, 3, 3, 3)


def _gram_of_moments(moments: Floats) -> Floats:
    """With x the homogeneous source and (u, v) the target, the two rows per match are (xᵀ, 0, −u xᵀ) and (0, xᵀ, −v xᵀ)
    for the rows of H stacked (Hartley & Zisserman, 2nd ed., equation 4.3).
    """
    plain, by_u, by_v = (moments[:, 2, :, axis] for axis in (2, 0, 1))
    by_both = moments[:, 0, :, 0] + moments[:, 1, :, 1]
    zero = np.zeros((3, 3))
    gram: Floats = np.block([[plain, zero, -by_u], [zero, plain, -by_v], [-by_u, -by_v, by_both]])
    return gram


def homography_from_gram(gram: Floats) -> Floats:
    """H (3, 3) of unit norm that minimises the algebraic error of a Gram matrix (9, 9)."""
    return np.linalg.eigh(gram)[1][:, 0].reshape(3, 3)


@dataclass(frozen=True)
class FaceGrams:
    """Everything that the transfer of intrinsics needs of the matches on three faces.

    `to_projector`, `to_camera`: Gram matrices (3, 9, 9) of each face's homography, in normalised coordinates;
    `camera_scale`, `projector_scale`: the normalisations (3, 3) from pixels.
    """

    to_projector: Floats
    to_camera: Floats
    camera_scale: Floats
    projector_scale: Floats

    def reversed(self) -> "FaceGrams":
        """The same with camera and projector exchanged."""
        return FaceGrams(self.to_camera, self.to_projector, self.projector_scale, self.camera_scale)

    def homographies(self) -> Floats:
        """Each face's homography camera → projector in pixels, (3, 3, 3)."""
        inverse = np.linalg.inv(self.projector_scale)
        return np.stack([inverse @ homography_from_gram(gram) @ self.camera_scale for gram in self.to_projector])


def face_grams(matches: Matches) -> FaceGrams:
    """Accumulate the Gram matrices of the faces 0, 1, 2. Raises TooFewMatchesError below four each."""
    if matches.face is None:
        raise ValueError("these matches have no face labels")
    labelled = matches[matches.face >= 0]
    camera_scale, projector_scale = normalisation(labelled.camera_px), normalisation(labelled.projector_px)

    def of_face(label: int) -> tuple[Floats, Floats]:
        face = matches.on_face(label)
        if len(face) < 4:
            raise TooFewMatchesError(f"face {label} has {len(face)} matches; a homography needs at least four")
        moments = _moments(_scaled(face.camera_px, camera_scale), _scaled(face.projector_px, projector_scale))
        return _gram_of_moments(moments), _gram_of_moments(moments.transpose(1, 0, 3, 2))

    forward, backward = zip(*in_parallel(of_face, FACES), strict=True)
    return FaceGrams(np.stack(forward), np.stack(backward), camera_scale, projector_scale)


def _scaled(points: Floats, scale: Floats) -> Floats:
    """Points (N, 2) by a similarity without rotation."""
    scaled: Floats = points * scale[0, 0] + scale[:2, 2]
    return scaled
