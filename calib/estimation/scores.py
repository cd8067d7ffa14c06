"""Rao's score: the gain of a fit if a common parameter were free for some of the patches, without fitting it.

C. R. Rao, *Large sample tests of statistical hypotheses concerning several parameters*, 1948. It tells whether all
stations that see a plane see one plane: what it would gain to let a station's view of it be another.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.estimation.likelihood import PLANE, AnyLayout, AnyPart, Fit, Part
from calib.geometry import PER_PLANE
from calib.numerics import Bools, Floats, Ints, huber_weights
from calib.refinement import ROBUST_SIGMAS, covariance_of

_LEAST_SHARE = 1e-3  # share of a parameter's own information below which a direction is undetermined


@dataclass(frozen=True, eq=False)
class PatchSums:
    """Sums of a patch: half the gradient (24,) and the information (24, 24) of its own columns, with their derivatives
    `by_room` (24, 30) by the room's `columns` (30,).
    """

    slope: Floats
    information: Floats
    columns: Ints
    by_room: Floats

    @classmethod
    def of(cls, patch: Part[AnyLayout], fit: Fit[AnyLayout], residual: Floats, variance: Floats) -> "PatchSums":
        """From a patch's `residual` (M, 2) of a fit, under a `variance` (M,) of each coordinate."""
        root = 1 / np.sqrt(variance)[:, None]
        jacobian, residual = patch.predict(fit.layout)[1] * root[:, :, None], residual * root
        weight = np.sqrt(huber_weights(np.linalg.norm(residual, axis=1), ROBUST_SIGMAS))
        rows, off = (
            (jacobian * weight[:, None, None]).reshape(-1, jacobian.shape[2]),
            (residual * weight[:, None]).ravel(),
        )
        return cls(rows.T @ off, rows.T @ rows, patch.columns(fit.layout), patch.carried(fit.layout))

    @property
    def pull(self) -> Floats:
        """Half the gradient of `columns`."""
        return self.by_room.T @ self.slope

    @property
    def weight(self) -> Floats:
        """The information of `columns`."""
        return self.by_room.T @ self.information @ self.by_room


def reweighted(
    patches: Sequence[Part[AnyLayout]],
    fit: Fit[AnyLayout],
    chosen: Iterable[int],
    used: Sequence[Floats],
    now: Sequence[Floats],
) -> tuple[Floats, Floats, list[PatchSums]]:
    """Half the gradient (size,) and the information (size, size) of a fit, and their change by the `chosen` patches.

    Variances (M,) of their cells are those of `now` instead of the `used` ones.
    """
    gradient, information, sums = fit.gradient.copy(), fit.information.copy(), list[PatchSums]()
    for i in chosen:
        before, after = (PatchSums.of(patches[i], fit, fit.residuals[i], each[i]) for each in (used, now))
        gradient[after.columns] += after.pull - before.pull
        information[np.ix_(after.columns, after.columns)] += after.weight - before.weight
        sums.append(after)
    return gradient, information, sums


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


def association_scores(
    patches: Sequence[Part[AnyLayout]], fit: Fit[AnyLayout], variances: Sequence[Floats], free: Bools
) -> tuple[Floats, Floats]:
    """Rao's score, a χ² statistic, of a separate plane for each patch, and its degrees of freedom, (patches,) each.

    A plane with one patch has no freedom. Scores of patches on one plane are dependent: those of two are equal.
    """
    covariance = covariance_of(fit.information, free)
    planes = np.array([patch.plane for patch in patches])
    tied = np.bincount(planes)[planes] > 1
    scores, freedom = np.zeros(len(patches)), np.zeros(len(patches))
    for i in np.flatnonzero(tied).tolist():
        sums = PatchSums.of(patches[i], fit, fit.residuals[i], variances[i])
        scores[i], freedom[i] = _score([sums], covariance, np.zeros(fit.layout.size))
    return scores, freedom


def plane_scores(
    patches: Sequence[Part[AnyLayout]],
    fit: Fit[AnyLayout],
    variances: Sequence[Floats],
    free: Bools,
    flat: Sequence[Floats],
) -> tuple[Floats, Floats]:
    """Scores and degrees of freedom of each plane of the room, for separate planes of all its patches, (planes,) each.

    `flat`: variances of cells on flat planes. Each plane is assumed to be flat, and the fit under its `variances`
    follows to first order: a plane with reduced weight must be tested with full weight.
    """
    scores, freedom = np.zeros(len(fit.layout.planes)), np.zeros(len(fit.layout.planes))
    planes = np.array([patch.plane for patch in patches])
    for plane in np.flatnonzero(np.bincount(planes) > 1):
        chosen = np.flatnonzero(planes == plane).tolist()
        gradient, information, own = reweighted(patches, fit, chosen, variances, flat)
        covariance = covariance_of(information, free)
        scores[plane], freedom[plane] = _score(own, covariance, -covariance @ gradient)
    return scores, freedom


def _score(patches: Sequence[PatchSums], covariance: Floats, step: Floats) -> tuple[float, float]:
    """Scores of separate planes for the patches."""
    across = np.zeros((len(patches) * PER_PLANE, len(step)))
    for rows, patch in zip(across.reshape(len(patches), PER_PLANE, -1), patches, strict=True):
        rows[:, patch.columns] = patch.information[PLANE] @ patch.by_room
    slope = np.concatenate([patch_sums.slope[PLANE] for patch_sums in patches])
    information = scipy.linalg.block_diag(*[patch_sums.information[PLANE, PLANE] for patch_sums in patches])
    tie_score = score(slope, information, across, covariance, step)
    return tie_score.value, tie_score.freedom


def separate_plane(layout: AnyLayout, parts: Sequence[AnyPart], number: int) -> tuple[AnyLayout, tuple[AnyPart, ...]]:
    """One part on a separate plane, added to the layout's, which starts at the common one."""
    part = parts[number]
    more = replace(layout, planes=(*layout.planes, layout.planes[part.plane]))
    return more, (*parts[:number], replace(part, plane=len(layout.planes)), *parts[number + 1 :])
