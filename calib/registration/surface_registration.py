"""Registration of two surfaces of any origin, clouds or meshes, without a first guess; whether it is right, and how
well.

Every hypothesis is refined, and judged by both surfaces: samples that coincide agree; samples a little in front of or
behind the other surface, facing the same way, contradict, because whoever saw the one looked through the other. A pose
is answered only if nothing of weight contradicts it, if no other pose fits as well, and if every direction is held.

The covariance is that of an M-estimator with clustered errors (`calib.numerics.shrunk_scatter`). How well directions
are held is counted by the product of both surfaces' normals, whose noise is independent: that of one alone would hold a
plane by its noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from calib.geometry import Pose
from calib.numerics import Floats, biweight, robust_sigma
from calib.registration.surface_fit import (
    FreeMotion,
    PairFit,
    SurfacePose,
    are_apart,
    free_motions,
    holds,
    is_rival,
    judge,
    needs_mirror_test,
    position_jacobian,
    surpasses,
    worth,
)
from calib.registration.surface_hypotheses import surface_poses
from calib.registration.surface_pair import (
    ACROSS,
    ALL_SAMPLES,
    ScaledPair,
    SurfacePair,
    SurfacePoints,
    on_surface,
    rescaled,
)

_FINAL_ROUNDS = 12
_WHOLE = 0.9  # share of a surface that coincides, beyond which hardly anything of it is elsewhere
_SOME, _SETTLING = 500, 1000  # samples: by which it is told whether two poses are one, and of the first fine steps
_HOPELESS, _WORSE = 0.1, 0.05  # of the most samples that hold any hypothesis; difference of agreeing shares
_PIECE = 4.0  # coarse cells across what may have moved a little as a whole, so that its errors are equal


class Alignment(Enum):
    """What is known of the pose of one surface on another."""

    UNIQUE = "unique"
    AMBIGUOUS = "ambiguous"
    """Several poses fit equally well."""
    LOOSE = "loose"
    """It may slide or turn."""
    NONE = "none"
    """No pose fits."""


@dataclass(frozen=True, eq=False)
class SurfaceRegistration:
    """The registration of a second surface on a first one."""

    alignment: Alignment
    best: SurfacePose | None
    """None where no hypothesis could be refined."""
    alternatives: tuple[SurfacePose, ...]
    """Other poses that fit as well. Poses of the mirror image are among them where nothing but planes coincides that
    bound the surfaces: two rooms that are mirror images have the same walls.
    """
    free: tuple[FreeMotion, ...]
    centre: Floats
    """(3,): the middle of the overlap, in the first one's frame."""
    covariance: Floats
    """(6, 6), or (7, 7) with the logarithm of the scale: of a rotation vector about the `centre` in radians, and a
    shift, in the first one's frame. NaN unless the pose is unique.
    """
    residual: float
    """Robust standard deviation of the samples' distances."""
    tolerance: float
    """Largest distance at which samples coincide."""

    def position_covariance(self, directions: Floats, points: Floats) -> Floats:
        """Variance (N,) that the pose gives points (N, 3) along directions (N, 3), in the first one's frame."""
        jacobian = self.jacobian(directions, points)
        variance: Floats = np.einsum("ni,ij,nj->n", jacobian, self.covariance, jacobian)
        return variance

    def jacobian(self, directions: Floats, points: Floats) -> Floats:
        """Derivatives (N, 6) or (N, 7) of positions (N, 3) along directions (N, 3) by what the covariance is of."""
        return position_jacobian(points - self.centre, directions, with_scale=len(self.covariance) == 7)


def register_surfaces(
    first: SurfacePoints,
    second: SurfacePoints,
    scales: Sequence[float] = (1.0,),
    *,
    with_scale: bool = False,
    starts: Pose | None = None,
) -> SurfaceRegistration:
    """The pose of the second surface on the first.

    `scales`: factors of the second one's lengths to try, one of which has to be right, to 4 % if the scale is to be
    estimated as well. `starts` (K,): poses to begin at, instead of a search. Raises ValueError for too few points,
    ImportError where Open3D is missing.
    """
    pair = SurfacePair.of(first, second)
    candidates: list[_Candidate] = []
    for scale in scales:
        candidates += _refined(pair.scaled(scale), starts, with_scale=with_scale)
    return _answer(candidates, with_scale=with_scale, check_mirrored=starts is None)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A refined hypothesis: `moved`, the second side after its scale, in the middle frames; `sign` of its normals."""

    sides: ScaledPair
    place: Pose
    sign: float
    judged: SurfacePose

    def is_apart_from(self, other: "_Candidate") -> bool:
        """Whether another one puts the second surface in a different place."""
        second = self.sides.second
        points = (second.fine.some(_SOME).points + second.middle) / self.sides.scale
        return are_apart(self.judged, other.judged, points, self.sides.tolerance)

    def is_beaten_by(self, other: "_Candidate") -> bool:
        """Whether another one is the same, or so much better that a closer look at this one is of no use."""
        worse = self.judged.share < other.judged.share - _WORSE and surpasses(other.judged, self.judged)
        return worse or not self.is_apart_from(other)


def _refined(sides: ScaledPair, starts: Pose | None, *, with_scale: bool) -> list[_Candidate]:
    """The hypotheses for one scale, refined and judged."""
    first, second = (side.fine.coarser(sides.coarse) for side in (sides.first, sides.second))
    signs = (1.0,) if first.is_oriented and second.is_oriented else (1.0, -1.0)
    if starts is None:
        hypotheses = surface_poses(first, second, signs)
    else:
        to, of = (Pose(np.eye(3), side.middle) for side in (sides.first, sides.second))
        begun = Pose(starts.rotation, starts.translation + starts.rotation @ of.translation - to.translation)
        hypotheses = [begun] * len(signs)
    settled = [
        (*_settled(sides, poses[k], sign, with_scale=with_scale), sign)
        for sign, poses in zip(signs, hypotheses, strict=True)
        for k in range(len(poses.translation))
    ]
    least = max(1.0, _HOPELESS * max((held for held, *_ in settled), default=0))
    candidates = []
    for held, place, factor, sign in settled:
        if held >= least:
            moved = rescaled(sides, factor)
            candidates.append(_Candidate(moved, place, sign, judge(moved, place, sign)))
    return candidates


def _settled(sides: ScaledPair, place: Pose, sign: float, *, with_scale: bool) -> tuple[int, Pose, float]:
    """The number of samples that hold a hypothesis, 0 if they are too few, and its pose and scale after fine steps."""
    fine, tolerance = sides.first.fine.cell, sides.tolerance
    factor, many = 1.0, sides.second.judged
    few = many.some(_SETTLING)
    for reach, some in ((2 * fine + tolerance, few), (fine + tolerance, few), (tolerance, few), (tolerance, many)):
        fit = PairFit.at(sides, place, factor, sign, reach, some)
        if len(fit.residual) < 12:
            return 0, place, factor
        place, factor = fit.stepped(
            place, factor, np.clip(1 - (fit.residual / reach) ** 2, 0, None) ** 2, with_scale=with_scale
        )
    return len(fit.residual), place, factor


def _answer(candidates: list[_Candidate], *, with_scale: bool, check_mirrored: bool) -> SurfaceRegistration:
    """The best candidate, its rivals, and what is known of it."""
    size = 7 if with_scale else 6
    unknown = np.full((size, size), np.nan)
    if not candidates:
        return SurfaceRegistration(Alignment.NONE, None, (), (), np.zeros(3), unknown, np.nan, np.nan)
    ordered = sorted(_uncontradicted(candidates), key=lambda candidate: -worth(candidate.judged))
    best = _finished(ordered[0], with_scale=with_scale)
    tolerance = best.sides.tolerance
    fit = PairFit.at(best.sides, best.place, 1.0, best.sign, tolerance, best.sides.second.fine.some(ALL_SAMPLES))
    whole = best.judged
    if not holds(whole) or len(fit.residual) < 24:
        return SurfaceRegistration(Alignment.NONE, whole, (), (), np.zeros(3), unknown, np.nan, tolerance)
    centre = fit.points.mean(axis=0)
    residual = robust_sigma(fit.residual)
    shift = best.sides.first.middle
    free = free_motions(fit, centre, shift, with_scale=with_scale)
    made = SurfaceRegistration(Alignment.LOOSE, whole, (), free, centre + shift, unknown, residual, tolerance)
    if free:
        return made
    is_all = best.sides.has_closed and max(whole.overlap) > _WHOLE
    rivals = [candidate for candidate in ordered[1:] if is_rival(candidate.judged, whole, is_all=is_all)]
    alternatives = [rival.judged for rival in rivals if best.is_apart_from(rival)]
    if check_mirrored and not alternatives and max(whole.overlap) < _WHOLE and needs_mirror_test(ordered[0].judged):
        alternatives = _mirrored_rivals(ordered[0], with_scale=with_scale)
    if alternatives:
        return replace(made, alignment=Alignment.AMBIGUOUS, alternatives=tuple(alternatives))
    covariance = fit.covariance(centre, _PIECE * best.sides.coarse, with_scale=with_scale)
    return replace(made, alignment=Alignment.UNIQUE, covariance=covariance)


def _mirrored_rivals(best: _Candidate, *, with_scale: bool) -> list[SurfacePose]:
    """Poses of the second surface's mirror image that fit as well as the best one.

    No motion maps a scene onto its mirror image. Where nothing but bounds coincides and the image fits as well, or
    where the image is less contradicted, it is not told whether both surfaces are of one scene, or of two with like
    walls. A thing that is its own mirror image is no such case.
    """
    whole = best.judged
    sides = replace(best.sides, second=best.sides.second.mirrored)
    images = _uncontradicted(_refined(sides, None, with_scale=with_scale))
    return [
        replace(candidate.judged, is_mirrored=True)
        for candidate in images
        if holds(candidate.judged)
        and is_rival(candidate.judged, whole)
        and not surpasses(whole, candidate.judged)
        and (surpasses(candidate.judged, whole) or not whole.shows_more_than_bounds)
    ]


def _finished(candidate: _Candidate, *, with_scale: bool) -> _Candidate:
    """With all samples, and Tukey's weights."""
    place, sides, sign, factor = candidate.place, on_surface(candidate.sides), candidate.sign, 1.0
    some = sides.second.fine.some(ALL_SAMPLES)
    for _ in range(_FINAL_ROUNDS):
        fit = PairFit.at(sides, place, factor, sign, sides.tolerance, some)
        if len(fit.residual) < 12:
            return candidate
        stepped, factor_now = fit.stepped(place, factor, biweight(fit.residual), with_scale=with_scale)
        change = float(np.abs(stepped.translation - place.translation).max())
        change += float(stepped.angle_from(place)) * sides.coarse * ACROSS
        place, factor = stepped, factor_now
        if change < 1e-3 * max(robust_sigma(fit.residual), 1e-12):
            break
    sides = rescaled(sides, factor)
    return _Candidate(sides, place, sign, judge(rescaled(candidate.sides, factor), place, sign, ALL_SAMPLES))


def _uncontradicted(candidates: list[_Candidate]) -> list[_Candidate]:
    """Those that hold, each once, and that no other one, of a comparable size, shows to be contradicted by more than
    chance.
    """
    holding: list[_Candidate] = []
    for candidate in sorted(candidates, key=lambda candidate: -worth(candidate.judged)):
        if holds(candidate.judged) and not any(candidate.is_beaten_by(other) for other in holding):
            judged = judge(candidate.sides, candidate.place, candidate.sign, ALL_SAMPLES)
            holding.append(replace(candidate, judged=judged))
    sized = [
        candidate for candidate in holding if not any(surpasses(other.judged, candidate.judged) for other in holding)
    ]
    return sized or candidates
