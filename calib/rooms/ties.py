"""Do all stations that see a plane see one plane? What it would gain to let a station's view of it be another."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from calib.numerics import Bools, Floats, Ints
from calib.refinement import covariance_of
from calib.refinement.likelihood import ROBUST_SIGMAS
from calib.rooms.likelihood import Fit
from calib.rooms.patches import OWN, Patch, carried, columns_of, predict_patch
from calib.rooms.planes import RoomPlane
from calib.rooms.room import PER_PLANE, Room

_LEAST_SHARE = 1e-3  # of a patch's own information: a tie that tells less in a direction is none in that


def tie_scores(patches: Sequence[Patch], fit: Fit, variances: Sequence[Floats], free: Bools) -> tuple[Floats, Floats]:
    """Rao's score of each patch for a plane of its own, which is χ², and its degrees of freedom, (patches,) each.

    A plane that one patch is on has no freedom. Scores of patches on one plane tell the same: of two they are equal.
    """
    covariance = covariance_of(fit.information, free)
    planes = np.array([patch.plane for patch in patches])
    tied = np.bincount(planes)[planes] > 1
    scores, freedom = np.zeros(len(patches)), np.zeros(len(patches))
    for i in np.flatnonzero(tied).tolist():
        sums = _Sums.of(patches[i], fit, fit.residuals[i], variances[i])
        scores[i], freedom[i] = _score([sums], covariance, np.zeros(fit.room.size))
    return scores, freedom


def plane_scores(
    patches: Sequence[Patch], fit: Fit, variances: Sequence[Floats], free: Bools, flat: Sequence[Floats]
) -> tuple[Floats, Floats]:
    """The same of each plane of the room, for as many planes as there are patches on it, (planes,) each.

    `flat`: variances of cells on planes that are flat, of which each plane is taken to be one, where the fit under its
    `variances` follows to the first order: a plane that was given less weight must not be tested with less.
    """
    scores, freedom = np.zeros(len(fit.room.planes)), np.zeros(len(fit.room.planes))
    planes = np.array([patch.plane for patch in patches])
    for plane in np.flatnonzero(np.bincount(planes) > 1):
        gradient, information, own = fit.gradient.copy(), fit.information.copy(), list[_Sums]()
        for i in np.flatnonzero(planes == plane).tolist():
            used, now = (_Sums.of(patches[i], fit, fit.residuals[i], each[i]) for each in (variances, flat))
            gradient[now.columns] += now.pull - used.pull
            information[np.ix_(now.columns, now.columns)] += now.weight - used.weight
            own.append(now)
        covariance = covariance_of(information, free)
        scores[plane], freedom[plane] = _score(own, covariance, -covariance @ gradient)
    return scores, freedom


@dataclass(frozen=True, eq=False)
class _Sums:
    """Of a patch: half the gradient (24,) and the information (24, 24) of its own columns, which follow the room's
    `columns` (30,) by `by_room` (24, 30).
    """

    slope: Floats
    information: Floats
    columns: Ints
    by_room: Floats

    @classmethod
    def of(cls, patch: Patch, fit: Fit, residual: Floats, variance: Floats) -> "_Sums":
        root = 1 / np.sqrt(variance)[:, None]
        jacobian, residual = predict_patch(fit.room, patch)[1] * root[:, :, None], residual * root
        weight = np.sqrt(np.minimum(1.0, ROBUST_SIGMAS / np.maximum(np.linalg.norm(residual, axis=1), 1e-12)))
        rows, off = (
            (jacobian * weight[:, None, None]).reshape(-1, jacobian.shape[2]),
            (residual * weight[:, None]).ravel(),
        )
        return cls(rows.T @ off, rows.T @ rows, columns_of(fit.room, patch), carried(fit.room, patch))

    @property
    def pull(self) -> Floats:
        """Half the gradient of `columns`."""
        return self.by_room.T @ self.slope

    @property
    def weight(self) -> Floats:
        """The information of `columns`."""
        return self.by_room.T @ self.information @ self.by_room


def _score(patches: Sequence[_Sums], covariance: Floats, step: Floats) -> tuple[float, float]:
    """gᵀ (A − C H⁻¹ Cᵀ)⁻¹ g of the patches' gradients g by planes of their own, after a `step` (size,) of the room; and
    its degrees of freedom. A is their information, C that by these and the room's columns, H⁻¹ the room's covariance.
    """
    across = np.zeros((len(patches) * PER_PLANE, len(step)))
    for rows, each in zip(across.reshape(len(patches), PER_PLANE, -1), patches, strict=True):
        rows[:, each.columns] = each.information[OWN] @ each.by_room
    slope = np.concatenate([each.slope[OWN] for each in patches]) + across @ step
    information = block_diag(*[each.information[OWN, OWN] for each in patches])
    left = information - across @ covariance @ across.T
    scale = np.sqrt(np.diag(information))
    shares, directions = np.linalg.eigh(left / np.outer(scale, scale))
    told = shares > _LEAST_SHARE
    score = np.sum((directions.T @ (slope / scale))[told] ** 2 / shares[told])
    return float(score), float(np.count_nonzero(told))


def untied(room: Room, patches: Sequence[Patch], number: int) -> tuple[Room, tuple[Patch, ...]]:
    """One patch on a plane of its own, added to the room's, which begins where the common one is."""
    patch = patches[number]
    apart = replace(patch, plane=len(room.planes))
    plane = room.planes[patch.plane]
    return (
        replace(room, planes=(*room.planes, RoomPlane(plane.normal, plane.offset))),
        (*patches[:number], apart, *patches[number + 1 :]),
    )
