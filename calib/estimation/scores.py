"""Rao's score: the gain of a fit if a common parameter were free for some of the patches, without fitting it.

C. R. Rao, *Large sample tests of statistical hypotheses concerning several parameters*, 1948.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.estimation.likelihood import AnyLayout, Fit, Part
from calib.numerics import Floats, Ints, huber_weights
from calib.refinement import ROBUST_SIGMAS

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
