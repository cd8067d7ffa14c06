"""Do all stations that see a plane see one plane? What it would gain to let a station's view of it be another."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from calib.estimation.likelihood import PLANE, AnyLayout, AnyPart, Fit, Part
from calib.estimation.scores import PatchSums, reweighted, score
from calib.geometry import PER_PLANE
from calib.numerics import Bools, Floats
from calib.refinement import covariance_of

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
    information = block_diag(*[patch_sums.information[PLANE, PLANE] for patch_sums in patches])
    tie_score = score(slope, information, across, covariance, step)
    return tie_score.value, tie_score.freedom


def separate_plane(layout: AnyLayout, parts: Sequence[AnyPart], number: int) -> tuple[AnyLayout, tuple[AnyPart, ...]]:
    """One part on a separate plane, added to the layout's, which starts at the common one."""
    part = parts[number]
    more = replace(layout, planes=(*layout.planes, layout.planes[part.plane]))
    return more, (*parts[:number], replace(part, plane=len(layout.planes)), *parts[number + 1 :])
