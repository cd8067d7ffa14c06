"""Plane-induced homographies and their Gram matrices.

The paper's algorithm needs only the normal matrix of each face's homography DLT. It is accumulated once, so a search
costs the same for a hundred matches as for a million.
"""

from dataclasses import dataclass

import numpy as np

from calib.geometry.matches import FACES, Matches
from calib.numerics import Floats, Ints, compiled, in_pieces, normalisation, scaling_about

_FACES = len(FACES)
# Index of the product x_i x_j among x², xy, y², x, y, 1.
_PRODUCT = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])


class TooFewMatchesError(ValueError):
    """A face has too few matches to determine its homography."""


def homogeneous(points: Floats) -> Floats:
    """Append a one: (..., 2) → (..., 3)."""
    return np.concatenate([points, np.ones_like(points[..., :1])], axis=-1)


def dehomogenise(points: Floats) -> Floats:
    """(..., 3) → (..., 2)."""
    return points[..., :2] / points[..., 2:]


def homography_between(source: Floats, target: Floats) -> Floats:
    """H (3, 3) with target ~ H source for points (N, 2), by the normalised direct linear transform."""
    before, after = normalisation(source), normalisation(target)
    (moments,) = _moments(source, target, np.zeros(len(source), np.int32), before, after, labels=1)
    return np.linalg.inv(after) @ homography_from_gram(_gram_of_moments(moments)) @ before


def mapped(homography: Floats, points: Floats) -> Floats:
    """Map points (N, 2) by a homography (3, 3)."""
    image = np.empty((len(points), 2))
    _map(np.ascontiguousarray(homography, np.float64), _as_floats(points), image)
    return image


@compiled
def _map(homography: Floats, points: Floats, image: Floats) -> None:
    (a, b, c), (d, e, f), (g, h, k) = homography
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        third = g * x + h * y + k
        image[i, 0], image[i, 1] = (a * x + b * y + c) / third, (d * x + e * y + f) / third


def _gram_of_moments(moments: Floats) -> Floats:
    """With x the homogeneous source and (u, v) the target, the two rows per match are (xᵀ, 0, −u xᵀ) and (0, xᵀ, −v xᵀ)
    for the rows of H stacked (Hartley & Zisserman, 2nd ed., equation 4.3).
    """
    plain, by_u, by_v = (moments[:, 2, :, axis] for axis in (2, 0, 1))
    by_both = moments[:, 0, :, 0] + moments[:, 1, :, 1]
    zero = np.zeros((3, 3))
    return np.block([[plain, zero, -by_u], [zero, plain, -by_v], [-by_u, -by_v, by_both]])


def homography_from_gram(gram: Floats) -> Floats:
    """H (3, 3) of unit norm that minimises the algebraic error of a Gram matrix (9, 9)."""
    return np.linalg.eigh(gram)[1][:, 0].reshape(3, 3)


@dataclass(frozen=True)
class FaceGrams:
    """Sufficient statistics of the matches on three faces for the transfer of intrinsics.

    `to_projector`, `to_camera`: Gram matrices (3, 9, 9) of each face's homography, in normalised coordinates;
    `camera_scale`, `projector_scale`: the normalisations (3, 3) from pixels.
    """

    to_projector: Floats
    to_camera: Floats
    camera_scale: Floats
    projector_scale: Floats

    def reversed(self) -> "FaceGrams":
        """Return the Gram matrices with camera and projector exchanged."""
        return FaceGrams(self.to_camera, self.to_projector, self.projector_scale, self.camera_scale)

    def homographies(self) -> Floats:
        """Each face's homography camera → projector in pixels, (3, 3, 3)."""
        inverse = np.linalg.inv(self.projector_scale)
        return np.stack([inverse @ homography_from_gram(gram) @ self.camera_scale for gram in self.to_projector])


def face_grams(matches: Matches) -> FaceGrams:
    """Accumulate the Gram matrices of faces 0, 1, 2. Raises TooFewMatchesError if a face has fewer than four."""
    face = matches.labels
    counts, camera_scale, projector_scale = _normalisations(matches, face)
    for label in FACES:
        if counts[label] < 4:
            raise TooFewMatchesError(f"face {label} has {counts[label]} matches; a homography needs at least four")
    moments = _moments(matches.camera_px, matches.projector_px, face, camera_scale, projector_scale, len(FACES))
    return FaceGrams(
        np.stack([_gram_of_moments(moment) for moment in moments]),
        np.stack([_gram_of_moments(face_moments.transpose(1, 0, 3, 2)) for face_moments in moments]),
        camera_scale,
        projector_scale,
    )


def _normalisations(matches: Matches, face: Ints) -> tuple[Ints, Floats, Floats]:
    """Number of matches on each face (3,), and the normalisations (3, 3) of both images for all of them together."""

    def piece(at: slice) -> tuple[Floats, Floats, Ints]:
        camera_px, projector_px = _as_floats(matches.camera_px[at]), _as_floats(matches.projector_px[at])
        return camera_px, projector_px, _as_ints(face[at])

    def summed(at: slice) -> Floats:
        totals = np.zeros((len(FACES), 5))
        _add_up(*piece(at), totals)
        return totals

    totals = np.sum(in_pieces(len(matches), summed), axis=0)
    count = totals[:, 0].sum()
    centre = totals[:, 1:].sum(axis=0) / max(count, 1)
    lengths = np.sum(in_pieces(len(matches), lambda at: _lengths(*piece(at), centre)), axis=0) / max(count, 1)
    scales = (scaling_about(centre[:2], lengths[0]), scaling_about(centre[2:], lengths[1]))
    return totals[:, 0].astype(np.int64), *scales


def _moments(
    source: Floats, target: Floats, label: Ints, source_scale: Floats, target_scale: Floats, labels: int
) -> Floats:
    """Means of x_i u_a x_j u_b, (labels, 3, 3, 3, 3) in the order i, a, j, b, over the matches with each label.

    x, u: homogeneous points, normalised by similarities without rotation. Negative labels are ignored.
    """

    def summed(at: slice) -> Floats:
        sums = np.zeros((labels, 6, 6))
        _add_products(
            _as_floats(source[at]), _as_floats(target[at]), _as_ints(label[at]), source_scale, target_scale, sums
        )
        return sums

    sums: Floats = np.sum(in_pieces(len(label), summed), axis=0)
    means = sums / sums[:, 5:, 5:]
    return means[:, _PRODUCT][:, :, :, _PRODUCT].transpose(0, 1, 3, 2, 4)


def _as_floats(points: Floats) -> Floats:
    return np.ascontiguousarray(points, np.float64)


def _as_ints(labels: Ints) -> Ints:
    return np.ascontiguousarray(labels, np.int32)


@compiled
def _add_products(
    source: Floats, target: Floats, label: Ints, source_scale: Floats, target_scale: Floats, sums: Floats
) -> None:
    """Sums (labels, 6, 6) of products of the second degree in x times products of the second degree in u."""
    x, u = np.empty(6), np.empty(6)
    for i in range(len(label)):
        if not 0 <= label[i] < len(sums):
            continue
        for point, scale, products in ((source[i], source_scale, x), (target[i], target_scale, u)):
            a, b = scale[0, 0] * point[0] + scale[0, 2], scale[1, 1] * point[1] + scale[1, 2]
            products[0], products[1], products[2] = a * a, a * b, b * b
            products[3], products[4], products[5] = a, b, 1.0
        of_label = sums[label[i]]
        for p in range(6):
            for q in range(6):
                of_label[p, q] += x[p] * u[q]


@compiled
def _add_up(camera_px: Floats, projector_px: Floats, face: Ints, totals: Floats) -> None:
    """For each face the number of its matches and the sums of their four coordinates, (3, 5)."""
    for i in range(len(face)):
        if 0 <= face[i] < len(totals):
            total = totals[face[i]]
            total[0] += 1
            total[1] += camera_px[i, 0]
            total[2] += camera_px[i, 1]
            total[3] += projector_px[i, 0]
            total[4] += projector_px[i, 1]


@compiled
def _lengths(camera_px: Floats, projector_px: Floats, face: Ints, centre: Floats) -> Floats:
    """Sums (2,) of the distances of the matches on faces from the `centre` (4,) of either image."""
    camera = projector = 0.0
    for i in range(len(face)):
        if 0 <= face[i] < _FACES:
            camera += np.sqrt((camera_px[i, 0] - centre[0]) ** 2 + (camera_px[i, 1] - centre[1]) ** 2)
            projector += np.sqrt((projector_px[i, 0] - centre[2]) ** 2 + (projector_px[i, 1] - centre[3]) ** 2)
    return np.array([camera, projector])
