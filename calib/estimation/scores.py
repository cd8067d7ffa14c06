"""Rao's score: the gain of a fit if a common parameter were free for some of the patches, without fitting it.

C. R. Rao, *Large sample tests of statistical hypotheses concerning several parameters*, 1948. It tells whether all
stations that see a plane see one plane: what it would gain to let a station's view of it be another.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.estimation.problem import PLANE, AnyPlanePart, AnyPlanes, Fit, PlanePart, Problem, Term, add_up
from calib.geometry import PER_PLANE
from calib.numerics import Floats, Ints, Quadratic

_LEAST_SHARE = 1e-3  # share of a parameter's own information below which a direction is undetermined


@dataclass(frozen=True, eq=False)
class PatchSums:
    """Sums of a patch by its own columns, and by the layout's."""

    own: Quadratic
    """By its own columns, (P,)."""
    carried: Floats
    """(P, Q): derivatives of these by the layout's columns."""
    columns: Ints
    """(Q,): those columns."""

    @classmethod
    def of(cls, patch: PlanePart[AnyPlanes], fit: Fit[AnyPlanes], residual: Floats, variance: Floats) -> "PatchSums":
        """From a patch's `residual` (M, 2) of a fit, under a `variance` (M,) of each coordinate."""
        root = 1 / np.sqrt(variance)[:, None]
        jacobian = patch.predict(fit.state)[1] * root[:, :, None]
        own = Term.robust(np.arange(jacobian.shape[2]), residual * root, jacobian)
        return cls(own, patch.carried(fit.state), patch.columns(fit.state))

    @property
    def term(self) -> Term:
        """By the layout's columns."""
        own, by_layout = self.own, self.carried
        return Term(own.cost, by_layout.T @ own.gradient, by_layout.T @ own.information @ by_layout, self.columns)


def reweighted(
    problem: Problem[AnyPlanes, PlanePart[AnyPlanes]],
    fit: Fit[AnyPlanes],
    chosen: Sequence[int],
    variances: Sequence[Floats],
) -> tuple[Quadratic, list[PatchSums]]:
    """A fit as if the `chosen` parts had these `variances` (M,) of their cells, and the sums of these."""
    before, after = (
        [PatchSums.of(problem.parts[i], fit, fit.residuals[i], of_parts[i]) for i in chosen]
        for of_parts in (problem.variances, variances)
    )
    less, more = (add_up(fit.state.size, (sums.term for sums in of_parts)) for of_parts in (before, after))
    return Quadratic(
        fit.cost + more.cost - less.cost,
        fit.gradient + more.gradient - less.gradient,
        fit.information + more.information - less.information,
    ), after


@dataclass(frozen=True, eq=False)
class Score:
    """`value` follows χ² with this `freedom` if the hypothesis holds; `step` (P,): the step of the parameters."""

    value: float
    freedom: float
    step: Floats


def score(slope: Floats, information: Floats, across: Floats, covariance: Floats, step: Floats) -> Score:
    """gᵀ (A − C H⁻¹ Cᵀ)⁻¹ g of parameters (P,) that were held, after a `step` (size,) of the room.

    g is half their gradient, the `slope` (P,) before the step, A their `information` (P, P), C that by these and the
    room's columns, `across` (P, size), H⁻¹ the room's `covariance` (size, size).
    """
    slope = slope + across @ step
    remaining = information - across @ covariance @ across.T
    scale = np.sqrt(np.diag(information))
    shares, directions = np.linalg.eigh(remaining / np.outer(scale, scale))
    determined = shares > _LEAST_SHARE
    pull = (directions.T @ (slope / scale))[determined]
    value = float(np.sum(pull**2 / shares[determined]))
    return Score(
        value, float(np.count_nonzero(determined)), -directions[:, determined] @ (pull / shares[determined]) / scale
    )


WRONG_ASSOCIATION = 30.0  # per degree of freedom, relative to the usual value


def association_scores(problem: Problem[AnyPlanes, PlanePart[AnyPlanes]], fit: Fit[AnyPlanes]) -> tuple[Floats, Floats]:
    """Rao's score, a χ² statistic, of a separate plane for each patch, and its degrees of freedom, (patches,) each.

    A plane with one patch has no freedom. Scores of patches on one plane are dependent: those of two are equal.
    """
    covariance = problem.covariance(fit)
    planes = np.array([patch.plane for patch in problem.parts])
    tied = np.bincount(planes)[planes] > 1
    scores, freedom = np.zeros(len(planes)), np.zeros(len(planes))
    for i in np.flatnonzero(tied).tolist():
        sums = PatchSums.of(problem.parts[i], fit, fit.residuals[i], problem.variances[i])
        scores[i], freedom[i] = _score([sums], covariance, np.zeros(fit.state.size))
    return scores, freedom


def plane_scores(
    problem: Problem[AnyPlanes, PlanePart[AnyPlanes]], fit: Fit[AnyPlanes], flat: Sequence[Floats]
) -> tuple[Floats, Floats]:
    """Scores and degrees of freedom of each plane of the room, for separate planes of all its patches, (planes,) each.

    `flat`: variances of cells on flat planes. Each plane is assumed to be flat, and the fit under the problem's
    variances follows to first order: a plane with reduced weight must be tested with full weight.
    """
    scores, freedom = np.zeros(len(fit.state.planes)), np.zeros(len(fit.state.planes))
    planes = np.array([patch.plane for patch in problem.parts])
    for plane in np.flatnonzero(np.bincount(planes) > 1):
        flattened, own = reweighted(problem, fit, np.flatnonzero(planes == plane).tolist(), flat)
        covariance = problem.covariance(flattened)
        scores[plane], freedom[plane] = _score(own, covariance, -covariance @ flattened.gradient)
    return scores, freedom


def _score(patches: Sequence[PatchSums], covariance: Floats, step: Floats) -> tuple[float, float]:
    """Scores of separate planes for the patches."""
    across = np.zeros((len(patches) * PER_PLANE, len(step)))
    for rows, patch in zip(across.reshape(len(patches), PER_PLANE, -1), patches, strict=True):
        rows[:, patch.columns] = patch.own.information[PLANE] @ patch.carried
    slope = np.concatenate([patch.own.gradient[PLANE] for patch in patches])
    information = scipy.linalg.block_diag(*[patch.own.information[PLANE, PLANE] for patch in patches])
    tie_score = score(slope, information, across, covariance, step)
    return tie_score.value, tie_score.freedom


def separate_plane(
    layout: AnyPlanes, parts: Sequence[AnyPlanePart], number: int
) -> tuple[AnyPlanes, tuple[AnyPlanePart, ...]]:
    """One part on a separate plane, added to the layout's, which starts at the common one."""
    part = parts[number]
    more = replace(layout, planes=(*layout.planes, layout.planes[part.plane]))
    return more, (*parts[:number], replace(part, plane=len(layout.planes)), *parts[number + 1 :])
