"""Do all stations that see a plane see one plane? What it would gain to let a station's view of it be another."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.numerics import Bools, Floats
from calib.refinement import covariance_of
from calib.refinement.likelihood import ROBUST_SIGMAS
from calib.rooms.likelihood import Fit
from calib.rooms.patches import OWN, Patch, carried, columns_of, predict_patch
from calib.rooms.planes import RoomPlane
from calib.rooms.room import Room

_LEAST_SHARE = 1e-3  # of a patch's own information: a tie that tells less in a direction is none in that


def tie_scores(patches: Sequence[Patch], fit: Fit, variances: Sequence[Floats], free: Bools) -> tuple[Floats, Floats]:
    """Rao's score of each patch for a plane of its own, which is χ², and its degrees of freedom, (patches,) each.

    With a patch's information A and gradient g by its own plane, C by that and the room's columns, and the room's
    covariance H⁻¹, the score is gᵀ (A − C H⁻¹ Cᵀ)⁻¹ g. A plane that one patch is on has no freedom.
    """
    covariance = covariance_of(fit.information, free)
    planes = np.array([patch.plane for patch in patches])
    tied = np.bincount(planes)[planes] > 1
    scores, freedom = np.zeros(len(patches)), np.zeros(len(patches))
    for i in np.flatnonzero(tied).tolist():
        patch, root = patches[i], 1 / np.sqrt(variances[i])[:, None]
        jacobian = predict_patch(fit.room, patch)[1] * root[:, :, None]
        residual = fit.residuals[i] * root
        weight = np.sqrt(np.minimum(1.0, ROBUST_SIGMAS / np.maximum(np.linalg.norm(residual, axis=1), 1e-12)))
        jacobian, residual = jacobian * weight[:, None, None], residual * weight[:, None]
        own, columns = jacobian[:, :, OWN], columns_of(fit.room, patch)
        slope = np.einsum("nak,na->k", own, residual)
        information = np.einsum("nak,nal->kl", own, own)
        across = np.einsum("nak,nac->kc", own, jacobian) @ carried(fit.room, patch)
        left = information - across @ covariance[np.ix_(columns, columns)] @ across.T
        scale = np.sqrt(np.diag(information))
        shares, directions = np.linalg.eigh(left / np.outer(scale, scale))
        told = shares > _LEAST_SHARE
        scores[i] = np.sum((directions.T @ (slope / scale))[told] ** 2 / shares[told])
        freedom[i] = np.count_nonzero(told)
    return scores, freedom


def untied(room: Room, patches: Sequence[Patch], number: int) -> tuple[Room, tuple[Patch, ...]]:
    """One patch on a plane of its own, added to the room's, which begins where the common one is."""
    patch = patches[number]
    apart = replace(patch, plane=len(room.planes))
    plane = room.planes[patch.plane]
    return (
        replace(room, planes=(*room.planes, RoomPlane(plane.normal, plane.offset))),
        (*patches[:number], apart, *patches[number + 1 :]),
    )
