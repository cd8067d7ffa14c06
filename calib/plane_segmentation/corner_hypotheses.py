"""Select the triples of planes that can be the faces of a cuboid corner.

For a trial focal length of the camera, three planes give one corner in closed form, and with it the projector's
intrinsic matrix (the paper, sections 3.1 and 3.2). Three planes that are not perpendicular give a projector with
oblong or skewed pixels, or one that sees the walls from behind, whatever the focal length.

A squeezed or keystone-corrected projector image has the same effect. With square pixels, some triple may then look like
a corner by chance, such as two sides of a box and the floor. With the right pixel shape the walls form the corner, and
many more of the planes are parallel or perpendicular to each other.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calib.closed_form import decompose, share_in_front
from calib.geometry import CornerImage, corner_planes, homogeneous, inverse_depths
from calib.numerics import Floats
from calib.plane_segmentation.plane_parallax import TwoView
from calib.plane_segmentation.segmentation import Segments

# Lengths are in units of half the image's width, as in calib.plane_segmentation.plane_parallax: 0.4 to 4 image widths.
_FOCALS = np.geomspace(0.8, 8.0, 96)
_MATRICES = _FOCALS[:, None, None] * np.diag([1.0, 1.0, 0.0]) + np.diag([0.0, 0.0, 1.0])
_INVERSES = np.asarray(np.linalg.inv(_MATRICES))
_CANDIDATES = 10
_REGULAR_SHARE = 0.01
_ANGLE_SIGMA_DEG = 1.0
# Standard deviations: of the logarithm of the pixels' aspect and of the skew, for walls that are a little off square
# and a principal point that is not quite at the image's centre …
_SQUARE_SIGMA = 0.01
# … of the projector's principal point (a projector's lens is shifted), and of the logarithms of both focal lengths.
_CENTRE_SIGMA = (0.25, 0.5)
_LOG_FOCAL, _LOG_FOCAL_SIGMA = np.log(2.2), 0.8
# A triple whose projector pixels are further from square than this is not a corner …
_MOST_OFF_SQUARE = 0.03
# … or shows a picture of another shape: standard deviation of logarithm of the aspect and of skew among those.
_OBLONG_SIGMA = 0.3
_LEAST_IN_FRONT = 0.98
_PARALLEL_DEG = 2.0
_LEAST_OF_NEARER = 0.25


@dataclass(frozen=True)
class Triple:
    """`planes`: indices of three planes; `off_square`: deviation of the projector's pixels from square (root of the sum
    of squares of log-aspect and skew); `direction_sigma_deg`: standard deviation of the least certain of the three
    directions; `score`: larger is better. `inverse` (n, 3): unit normal over distance from the camera of every plane,
    up to a common scale, if these three are a corner.
    """

    planes: tuple[int, int, int]
    off_square: float
    direction_sigma_deg: float
    score: float
    inverse: Floats


@dataclass(frozen=True)
class Triples:
    """`square`: all triples that can be a corner if the projector's pixels are square, best first. `off_square`:
    deviation from square of the most likely pixels if they may have any shape; `oblong_nats`: log likelihood ratio of
    that solution to the best of `square`, −infinity if either is missing. `off_diamond`: least deviation of pixels with
    which three planes are a corner from those of a diamond array of mirrors, twice as wide as high or the reverse.
    """

    square: list[Triple]
    off_square: float
    oblong_nats: float
    off_diamond: float


def corner_triples(segments: Segments, camera_px: Floats, point: tuple[float, float] = (0.0, 0.0)) -> Triples:
    """Return the triples of planes that can be a corner; `camera_px` (M, 2): the surfels. `point`: the camera's
    principal point, in ideal coordinates.

    The score prefers planes with many surfels, and triples whose calibration makes other planes parallel or
    perpendicular to each other, as furniture mostly is.
    """
    x = _sample(segments, camera_px, point)
    segments = segments.about(point)
    view, planes, label = segments.view, segments.planes, segments.label
    share = np.bincount(label[label >= 0], minlength=len(planes)) / len(label)
    hypotheses, off_square, oblong_score, off_diamond = [], 0.0, -np.inf, np.inf
    for chosen in combinations(range(min(len(planes), _CANDIDATES)), 3):
        index = list(chosen)
        trials = _trials(view, planes[index], [x[i] for i in index], planes[share > _REGULAR_SHARE])
        if trials is None:
            continue
        large = float(np.sum(np.log(share[index])))
        off_diamond = min(off_diamond, trials.off_diamond)
        fit, oblong = trials.likeliest(_SQUARE_SIGMA), trials.likeliest(_OBLONG_SIGMA)
        if fit.off_square < _MOST_OFF_SQUARE:
            sigma = max(_direction_sigma_deg(fit, planes[i], segments.covariance[i]) for i in index)
            inverse = (planes - fit.at_infinity) * np.array([fit.focal, fit.focal, 1.0])
            hypotheses.append(Triple(chosen, fit.off_square, sigma, fit.likelihood + large, inverse))
        if oblong.likelihood + large > oblong_score:
            off_square, oblong_score = oblong.off_square, oblong.likelihood + large
    hypotheses.sort(key=lambda triple: -triple.score)
    # Densities of the two terms' priors at their peaks: a wider prior has a lower density.
    wider = 2 * np.log(_OBLONG_SIGMA / _SQUARE_SIGMA)
    oblong_nats = float(oblong_score - wider - hypotheses[0].score) if hypotheses else -np.inf
    return Triples(hypotheses, off_square, oblong_nats, off_diamond)


def outermost(triples: list[Triple], segments: Segments) -> Triple:
    """Return the best triple (the first), or one with parallel planes farther from the camera.

    The fronts of cupboards and the sides of boxes form many corners with the walls, but a room has one outermost
    corner: captures from different places agree on it. A farther plane counts if it is not much smaller.
    """
    best = triples[0]
    size = np.bincount(segments.label[segments.label >= 0], minlength=len(segments.planes))
    inverse_distance = np.linalg.norm(best.inverse, axis=1)
    unit = best.inverse / inverse_distance[:, None]

    def stands_for(plane: int, own: int) -> bool:
        parallel = unit[plane] @ unit[own] > np.cos(np.radians(_PARALLEL_DEG))
        farther = inverse_distance[plane] <= inverse_distance[own]
        return bool(parallel and farther and size[plane] >= _LEAST_OF_NEARER * size[own])

    standing_for = [
        triple
        for triple in triples
        if all(any(stands_for(plane, own) for plane in triple.planes) for own in best.planes)
    ]
    return min(standing_for, key=lambda triple: float(np.prod(inverse_distance[list(triple.planes)])))


def _sample(segments: Segments, camera_px: Floats, point: tuple[float, float]) -> list[Floats]:
    """Ideal homogeneous camera points of up to some fifty surfels of each plane, from a point on."""
    sample = []
    for plane in range(len(segments.planes)):
        members = camera_px[segments.label == plane]
        sample.append(homogeneous(segments.view.camera.ideal(members[:: max(1, len(members) // 50)]) - point))
    return sample


@dataclass(frozen=True)
class _Fit:
    """The most likely corner for three planes: camera focal length and parallax `at_infinity` (3,)."""

    focal: float
    at_infinity: Floats
    off_square: float
    likelihood: float


@dataclass(frozen=True)
class _Trials:
    """Corners for three planes: `focal` (n,), `at_infinity` (n, 3), log aspect and skew of the projector's pixels,
    `shape` (n, 2), and the `likelihood` (n,) of everything else.
    """

    focal: Floats
    at_infinity: Floats
    shape: Floats
    likelihood: Floats

    @property
    def off_diamond(self) -> float:
        """The least deviation of log aspect and skew from pixels twice as wide as high, or the reverse."""
        return float(np.hypot(np.abs(self.shape[:, 0]) - np.log(2), self.shape[:, 1]).min())

    def likeliest(self, sigma: float) -> _Fit:
        """Return the most likely trial if log aspect and skew have this standard deviation."""
        off_square = np.hypot(*self.shape.T)
        likelihood = self.likelihood - (off_square / sigma) ** 2 / 2
        best = int(np.argmax(likelihood))
        return _Fit(float(self.focal[best]), self.at_infinity[best], float(off_square[best]), float(likelihood[best]))


def _trials(view: TwoView, planes: Floats, x: list[Floats], further: Floats) -> _Trials | None:
    """Evaluate all focals and both corners for three planes (3, 3) with image points x; None if none is a corner.

    `others` (n, 3): planes of the same scene.
    """
    # The image of an edge is where its two planes have the same parallax; the three edges meet by construction.
    lines = np.roll(planes, -1, axis=0) - np.roll(planes, -2, axis=0)
    lines = lines / np.linalg.norm(lines, axis=1, keepdims=True)
    image = CornerImage(np.linalg.svd(lines)[2][2], lines)
    normals, rays = corner_planes(image, _INVERSES)
    normals, rays = normals.reshape(-1, 3, 3), np.concatenate([rays, rays])  # both solutions
    real = np.flatnonzero(np.isfinite(normals).all(axis=(1, 2)))
    if not len(real):  # most triples, whatever the focal
        return None
    focal, matrices, inverses = (of[real % len(_FOCALS)] for of in (_FOCALS, _MATRICES, _INVERSES))
    normals, rays = normals[real], rays[real]
    with np.errstate(all="ignore"):
        weights = inverse_depths(normals, rays, inverses)
        at_infinity, projector, positive = _transfer(view, planes, weights, matrices, x)
        shape = np.stack(
            [np.log(projector[:, 0, 0] / projector[:, 1, 1]), projector[:, 0, 1] / projector[:, 0, 0]], axis=1
        )
        cost = np.sum((projector[:, :2, 2] / _CENTRE_SIGMA) ** 2, axis=1)
        for length in (focal, projector[:, 0, 0]):
            cost += ((np.log(length) - _LOG_FOCAL) / _LOG_FOCAL_SIGMA) ** 2
        likelihood = _regularity(at_infinity, focal, further) - cost / 2
    possible = np.isfinite(likelihood) & np.isfinite(shape).all(axis=1) & (positive > _LEAST_IN_FRONT)
    if not possible.any():
        return None
    return _Trials(focal[possible], at_infinity[possible], shape[possible], likelihood[possible])


def _direction_sigma_deg(fit: _Fit, plane: Floats, covariance: Floats) -> float:
    """Standard deviation of the direction of a plane (3,) with covariance (3, 3), along its worst axis."""
    scale = np.array([fit.focal, fit.focal, 1.0])
    normal = (plane - fit.at_infinity) * scale
    length = np.linalg.norm(normal)
    across = np.eye(3) - np.outer(normal, normal) / length**2
    worst = np.linalg.eigvalsh(across @ (covariance * np.outer(scale, scale)) @ across)[-1]
    return float(np.degrees(np.sqrt(worst) / length))


def _regularity(at_infinity: Floats, focal: Floats, planes: Floats) -> Floats:
    """Return the log likelihood (n,) of the angles between planes (m, 3) under a mixture of 0°, 90° and uniform angles,
    for cameras of focal length `focal` (n,) with the plane at infinity (n, 3).
    """
    normals = (planes - at_infinity[:, None]) * np.stack([focal, focal, np.ones_like(focal)], axis=1)[:, None]
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    first, second = np.triu_indices(len(planes), 1)
    cosine = np.abs(np.sum(normals[:, first] * normals[:, second], axis=2))
    angle = np.degrees(np.arccos(np.minimum(cosine, 1.0)))
    off = np.minimum(angle, 90 - angle)
    regular = np.exp(-((off / _ANGLE_SIGMA_DEG) ** 2) / 2) * np.sqrt(2 / np.pi) / _ANGLE_SIGMA_DEG
    likelihood: Floats = np.sum(np.log((regular + 1 / 45) / 2), axis=1)
    return likelihood


def _transfer(
    view: TwoView, planes: Floats, weights: Floats, matrices: Floats, x: list[Floats]
) -> tuple[Floats, Floats, Floats]:
    """Transfer corners with inverse depths `weights` (n, 3, 3) in cameras `matrices` (n, 3, 3) to the projector.

    Return the parallax v∞ of the plane at infinity (n, 3), the projector's K (n, 3, 3), and the share (n,) of the
    faces' points x that lie in front of both devices.

    v_S = v∞ + s · weights_S with one s for all faces, and the homography A + e v∞ᵀ at infinity is K_p R K⁻¹.
    """
    apart_v = planes - np.roll(planes, 1, axis=0)
    apart_w = weights - np.roll(weights, 1, axis=1)
    scale = np.sum(apart_w * apart_v, axis=(1, 2)) / np.sum(apart_w**2, axis=(1, 2))
    at_infinity = planes[0] - scale[:, None] * weights[:, 0]
    homography = view.homography(at_infinity)
    motion = np.concatenate([homography @ matrices, (scale[:, None] * view.epipole)[..., None]], axis=2)
    projector, _, _ = decompose(motion)
    # With det(K R) > 0 the third coordinate of H x is depth in the projector over depth in the camera.
    orientation = np.sign(np.linalg.det(motion[:, :, :3]))[:, None, None]
    third_rows = orientation * (homography[:, 2, None] + (scale * view.epipole[2])[:, None, None] * weights)
    return at_infinity, projector, share_in_front(weights, third_rows, x)
