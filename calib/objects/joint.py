"""All poses of the views together: point to plane over every overlapping pair, keypoints of the pictures, and the
covariance.

The normal is the mean of both views', which cancels the curvature between the two points (Rusinkiewicz, "A symmetric
objective function for ICP", 2019). Errors of a view correlate within parts of its picture and affect all its pairs. So
the covariance is a sandwich whose scores are summed over such parts, not over points (Liang and Zeger, "Longitudinal
data analysis using generalized linear models", 1986).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np

from calib.estimation import ROBUST_SIGMAS, Term, add_up
from calib.geometry import IDENTITY, PER_POSE, Pose
from calib.numerics import Floats, Ints, huber_weights, robust_sigma
from calib.objects.patch_overlap import NARROW, WIDE, overlapping_pixels
from calib.objects.view import PARTS, STEEPEST, ObjectView
from calib.registration import adjust_places, couple_places, match_keypoints

_ROUNDS = (WIDE, 1.5, NARROW, NARROW, NARROW, NARROW)
_STEPS = 4  # steps per round
_FEWEST = 60  # patches per pair
_DAMPING = 1e-9
_MARK_GRAINS, _FEWEST_MARKS = 0.5, 6
_CONVERGED = 1e-7


@dataclass(frozen=True, eq=False)
class PairResiduals:
    """Of the views `first` < `second`: distances `off` (N,) along normals or axes, their `sigma` (N,).

    `by_first` (N, 6): derivatives by a twist of the first view about the frame's origin; those of the second are its
    negative. `parts` (N, 2): of the pictures.
    """

    first: int
    second: int
    off: Floats
    sigma: Floats
    by_first: Floats
    parts: Ints
    surface: int

    @property
    def weight(self) -> Floats:
        """Of each, under Huber's loss, (N,)."""
        size = np.abs(self.off) / self.sigma
        return huber_weights(size, ROBUST_SIGMAS) / self.sigma**2

    @property
    def term(self) -> Term:
        """What they add to the cost, by the twists of all places."""
        pulls = self.by_first * self.weight[:, None]
        return couple_places(self.first, self.second, pulls.T @ self.off, pulls.T @ self.by_first)


@dataclass(frozen=True, eq=False)
class JointEstimate:
    """`places`: X_common = R X_view + t, with the first view's fixed. `covariance` (6 n, 6 n): rotation about the
    common axes in radians, then shift of `middle`, a point (3,) of the thing.

    `information` (6 n, 6 n): of the residuals, the inverse covariance only if they are independent. `overlap`: by pair,
    share of matching patches; `residual`: by pair, robust root mean square along the normals, in the points' unit.
    """

    places: tuple[Pose, ...]
    covariance: Floats
    information: Floats
    middle: Floats
    overlap: Mapping[tuple[int, int], float]
    residual: Mapping[tuple[int, int], float]


def estimate_jointly(views: Sequence[ObjectView], places: Sequence[Pose]) -> JointEstimate:
    """From a start that is off by some grains at most."""
    first, middle = places[0].inverse(), views[0].middle
    now = [first @ place for place in places]
    pairs = list(combinations(range(len(views)), 2))
    overlaps: list[PairResiduals] = []

    def terms(places: Sequence[Pose]) -> list[Term]:
        nonlocal overlaps
        overlaps = _together(views, places, pairs, grains)
        return [pair.term for pair in overlaps]

    for grains in _ROUNDS:
        now, _ = adjust_places(now, terms, steps=_STEPS, converged=_CONVERGED * middle[2], damping=_DAMPING)
        pairs = [(pair.first, pair.second) for pair in overlaps] if grains == NARROW else pairs
    overlaps = _together(views, now, pairs, NARROW)
    total = {(pair.first, pair.second): pair for pair in overlaps}
    counts = {(i, j): len(views[i].pixel) + len(views[j].pixel) for i, j in total}
    return JointEstimate(
        tuple(now),
        *_covariance(overlaps, len(views), middle),
        middle,
        {numbers: pair.surface / counts[numbers] for numbers, pair in total.items()},
        {numbers: robust_sigma(pair.off[: pair.surface]) for numbers, pair in total.items()},
    )


def align(first: ObjectView, second: ObjectView, pose: Pose, grains: Sequence[float], count: int) -> Pose:
    """One pair alone, by some of the patches."""
    places = [IDENTITY, pose]
    for grain in grains:
        terms = partial(_terms_of_pair, first, second, grain * first.grain, count)
        places, _ = adjust_places(places, terms, steps=_STEPS, damping=_DAMPING)
    return places[1]


def _terms_of_pair(
    first: ObjectView, second: ObjectView, within: float, count: int, places: Sequence[Pose]
) -> list[Term]:
    residuals = residuals_of(first, second, (0, 1), places, within, count)
    return [] if residuals is None else [residuals.term]


def residuals_of(
    first: ObjectView,
    second: ObjectView,
    names: tuple[int, int],
    places: Sequence[Pose],
    within: float,
    count: int | None = None,
) -> PairResiduals | None:
    """Of one pair of views, `names` in `places`; None where too little meets."""
    here, there = places[names[0]], places[names[1]]
    pose = here.inverse() @ there
    parts = []
    for patches_of, seen_by, to_seen, back in ((second, first, pose, 1.0), (first, second, pose.inverse(), -1.0)):
        pixel = overlapping_pixels(patches_of.patches.first(count), seen_by, to_seen, within)
        met = np.flatnonzero(pixel >= 0)
        # Half a pixel is a long way along an oblique surface; normals at the rim have a common bias.
        met = met[(seen_by.facing(pixel[met]) > STEEPEST) & seen_by.inner[pixel[met]]]
        own, other = patches_of.pixel[met], pixel[met]
        parts.append((own, other) if back > 0 else (other, own))
    on_second, on_first = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    if len(on_first) < (_FEWEST if count is None else _FEWEST // 4):
        return None
    points, normals = _carried(first, here, on_first)
    others, turned = _carried(second, there, on_second)
    mean = normals + turned
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    off = np.sum(mean * (points - others), axis=1)
    sigma = np.hypot(first.sigma(on_first), second.sigma(on_second))
    sigma = sigma * max(1.0, robust_sigma(off / sigma))
    by_first = np.hstack([np.cross((points + others) / 2, mean), mean])
    part = np.stack([first.parts(first.pixels(on_first)), second.parts(second.pixels(on_second))], axis=1)
    surface = PairResiduals(*names, off, sigma, by_first, part, len(off))
    return _with_marks(surface, first, second, here, there)


def _carried(view: ObjectView, place: Pose, flat: Ints) -> tuple[Floats, Floats]:
    points, normals = (values.reshape(-1, 3)[flat].astype(np.float64) for values in view.image[:2])
    return place @ points, place.rotate(normals)


def _with_marks(
    surface: PairResiduals, first: ObjectView, second: ObjectView, here: Pose, there: Pose
) -> PairResiduals:
    """The residuals with those of the keypoints, which also act along the surface."""
    own, other = match_keypoints(first.keypoints, second.keypoints)
    points = here @ first.keypoints.points[own]
    others = there @ second.keypoints.points[other]
    near = np.linalg.norm(points - others, axis=1) < 2 * _MARK_GRAINS * first.grain
    if np.count_nonzero(near) < _FEWEST_MARKS:
        return surface
    points, others = points[near], others[near]
    off = points - others
    sigma = max(robust_sigma(off.ravel()), 1e-3 * first.grain)
    axes = np.broadcast_to(np.eye(3), (len(off), 3, 3))
    by_first = np.concatenate([np.cross(((points + others) / 2)[:, None], axes), axes], axis=2).reshape(-1, 6)
    part = np.stack(
        [first.parts(first.keypoints.pixels[own][near]), second.parts(second.keypoints.pixels[other][near])], axis=1
    )
    return PairResiduals(
        surface.first,
        surface.second,
        np.concatenate([surface.off, off.ravel()]),
        np.concatenate([surface.sigma, np.full(off.size, sigma)]),
        np.concatenate([surface.by_first, by_first]),
        np.concatenate([surface.parts, np.repeat(part, 3, axis=0)]),
        surface.surface,
    )


def _together(
    views: Sequence[ObjectView], places: Sequence[Pose], pairs: Sequence[tuple[int, int]], grains: float
) -> list[PairResiduals]:
    found = (residuals_of(views[i], views[j], (i, j), places, grains * views[0].grain) for i, j in pairs)
    return [each for each in found if each is not None]


def _covariance(pairs: Sequence[PairResiduals], count: int, middle: Floats) -> tuple[Floats, Floats]:
    """And the information, about the middle: its shifts are known far better than those of the camera's centre."""
    turned = np.kron(np.eye(count), Pose(np.eye(3), -middle).adjoint)
    matrix = add_up(PER_POSE * count, (pair.term for pair in pairs)).information
    bread = np.zeros_like(matrix)
    free = matrix[6:, 6:]
    scale = np.sqrt(np.maximum(np.diag(free), 1e-30))
    bread[6:, 6:] = np.linalg.pinv(free / np.outer(scale, scale), rcond=1e-12, hermitian=True) / np.outer(scale, scale)
    filling = _filling(pairs, count)
    back = np.linalg.inv(turned)
    return turned @ (bread @ filling @ bread) @ turned.T, back.T @ matrix @ back


def _filling(pairs: Sequence[PairResiduals], count: int) -> Floats:
    """Scatter (6 n, 6 n) of the gradient, summed over parts of pictures.

    A part's sum holds its own error once for each pair k that it is in, and those of k other parts once: of its square
    k of k + 1 are its own.
    """
    sums = np.zeros((count, PARTS, 6 * count))
    of_view = np.zeros(count)
    for pair in pairs:
        pulls = pair.by_first * (pair.weight * pair.off)[:, None]
        i, j = slice(6 * pair.first, 6 * pair.first + 6), slice(6 * pair.second, 6 * pair.second + 6)
        for side, view in enumerate((pair.first, pair.second)):
            own = np.zeros((PARTS, 6))
            np.add.at(own, pair.parts[:, side], pulls)
            sums[view, :, i] += own
            sums[view, :, j] -= own
            of_view[view] += 1
    share = of_view / (of_view + 1)
    flat = (np.sqrt(share)[:, None, None] * sums).reshape(-1, 6 * count)
    return flat.T @ flat
