"""Tests whether captures of a corner and prior knowledge of the rig are consistent with one unchanged rig."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy

from calib.diagnostics.uncertainty import Uncertainty
from calib.finding import FindingKind
from calib.numerics import Bools, Floats, covariance_of
from calib.refinement import CAMERA, PROJECTOR, ROTATION, SHARED, TRANSLATION, CornerFit, KnownRig, Refinement
from calib.refusal import RefusalError

_SIGNIFICANT = 0.9999
_INFORMATIVE = 1e-3  # relative reduction of a variance: below it, corners carry no information along that direction
_NAMED = 3
_MOST_OF_IT = "Most of it is explained by a change of"
_FACTORS = {"%": 100.0, "°": 180 / np.pi}
# Columns, unit, and how far such a parameter usually changes: where two explain a step alike, the usual change is it.
_ROWS = (
    ("the camera's focal length", (CAMERA.start,), "%", 0.01),
    ("the camera's principal point", (CAMERA.start + 1, CAMERA.start + 2), "px", 5.0),
    ("the camera's distortion", (CAMERA.start + 3, CAMERA.start + 4), "", 0.01),
    ("the projector's focal length", (PROJECTOR.start,), "%", 0.01),
    ("the projector's principal point", (PROJECTOR.start + 1, PROJECTOR.start + 2), "px", 5.0),
    ("the projector's distortion", (PROJECTOR.start + 3, PROJECTOR.start + 4), "", 0.01),
    ("the rotation between them", tuple(range(ROTATION.start, ROTATION.stop)), "°", 0.01),
    ("the direction of the baseline", tuple(range(TRANSLATION.start, TRANSLATION.stop)), "°", 0.01),
)

RIG_CHANGED = FindingKind(
    "rig-changed",
    "The rig changed between captures that were calibrated together, or between captures and boards.",
    "Calibrate from either alone, or capture both again without refocusing, zooming or moving a device.",
    ("cost", "limit", "captures"),
)


class ContradictionError(RefusalError):
    """Captures of a corner and other data are not of one unchanged rig."""


def refuse_contradiction(refinement: Refinement, rig: KnownRig, systematic: Floats) -> tuple[float, float]:
    """The increase of −2 log likelihood of the captures by the prior knowledge of the rig, and its limit.

    With true sigmas the increase is χ², with one degree of freedom for each direction that both determine. `systematic`
    (size, size): the part of the covariance that no residual shows. It widens the distribution, by Satterthwaite's
    approximation (1946, Biometrics Bulletin 2, 110). Raises ContradictionError beyond the limit (0.9999).
    """
    apart = refinement.apart
    if apart is None:
        return 0.0, np.inf
    raised = max(refinement.fit.cost - apart.cost, 0.0)
    limit = _limit(refinement, rig, systematic[:SHARED, :SHARED])
    if raised > limit:
        raise ContradictionError(
            RIG_CHANGED,
            f"The rig changed between these captures and the boards: fitted together, −2 log likelihood is higher by "
            f"{raised:.0f}, where chance explains at most {limit:.0f}. Fitted separately, they differ in "
            f"{_differences_from(rig, apart, refinement.prior.free)}.",
            "Something was refocused, zoomed or moved between the two: calibrate from either alone, or capture both "
            "again without a change.",
            {"cost": raised, "limit": limit},
        )
    return raised, limit


def refuse_changed_rig(alone: Mapping[int, Uncertainty]) -> None:
    """Compare fits of captures, each alone, by their numbers from 0, with the sum of their covariances.

    Raises ContradictionError for the two that differ most, if chance does not explain that (0.9999). Priors count in
    both covariances, as if they were independent, so that differences are rather taken for smaller than they are.
    """
    limit = float(scipy.special.chdtri(SHARED, 1 - _SIGNIFICANT))
    worst: tuple[float, int, int, RigChange] | None = None
    for (first, one_fit), (second, another_fit) in combinations(alone.items(), 2):
        covariance = one_fit.covariance + another_fit.covariance
        rig = KnownRig(one_fit.state, covariance)
        step = rig.step_to(another_fit.rig)
        cost = float(step @ rig.precision @ step)
        if cost > (limit if worst is None else worst[0]):
            worst = cost, first + 1, second + 1, explain_change(step, rig.precision)
    if worst is not None:
        cost, first, second, change = worst
        raise ContradictionError(
            RIG_CHANGED,
            f"The rig changed between captures {first} and {second}: each is fine alone, but together they are not of "
            f"one rig. {change}.",
            "Something was refocused, zoomed or moved between the two: calibrate from captures of one unchanged rig.",
            {"cost": cost, "limit": limit, "captures": (first, second)},
        )


@dataclass(frozen=True, eq=False)
class RigChange:
    """A step of a rig, by the parameter that explains it best if that alone has changed."""

    times: float
    """How much less likely the step is than the limit of chance (0.9999), which is 1."""
    name: str
    """The parameter, in words."""
    amount: float
    """By how much it has changed, in `unit`."""
    sigma: float
    """Standard deviation of `amount`."""
    unit: str
    """%, px, ° or nothing."""
    step: Floats
    """(21,): that of the rig if the parameter alone has changed."""
    is_all: bool
    """Whether what it leaves over is chance."""

    @property
    def is_significant(self) -> bool:
        """Whether chance does not explain the step."""
        return self.times > 1

    def __str__(self) -> str:
        """A sentence without a full stop."""
        amount = f"{self.name} by {_amount(self.amount, self.unit)} ± {_amount(self.sigma, self.unit)}"
        return f"A change of {amount} explains it" if self.is_all else f"{_MOST_OF_IT} {amount}, but not all"


def explain_change(step: Floats, precision: Floats) -> RigChange:
    """The parameter that explains a step (21,) of the rig best. `precision` (21, 21): inverse covariance of the step.

    Most parameters are known too little by themselves for a difference to show; their combination is not.
    """
    limit = float(scipy.special.chdtri(SHARED, 1 - _SIGNIFICANT))
    pull = precision @ step
    cost = float(step @ pull)
    changes = []
    for name, columns, unit, usual in _ROWS:
        chosen = list(columns)
        own = precision[np.ix_(chosen, chosen)]
        change = np.asarray(np.linalg.solve(own, pull[chosen]), np.float64)
        rest = cost - float(change @ pull[chosen])
        alone = np.zeros(SHARED)
        alone[chosen] = change
        size, factor = float(np.linalg.norm(change)), _FACTORS.get(unit, 1.0)
        sigma = float(change @ np.linalg.solve(own, change)) ** 0.5 / max(size, 1e-300)
        described = RigChange(cost / limit, name, factor * size, factor * sigma, unit, alone, rest <= limit)
        changes.append((rest + (size / usual) ** 2, described))
    return min(changes, key=lambda change: change[0])[1]


def _limit(refinement: Refinement, rig: KnownRig, systematic: Floats) -> float:
    scale = np.sqrt(rig.safe_covariance.diagonal())
    root = np.linalg.cholesky(rig.safe_covariance / np.outer(scale, scale)) * scale[:, None]
    inverse = np.linalg.inv(root)
    joint = covariance_of(refinement.fit.information, refinement.prior.free)[:SHARED, :SHARED]
    reduction, directions = np.linalg.eigh(np.eye(SHARED) - inverse @ joint @ inverse.T)
    both = reduction > _INFORMATIVE
    if not both.any():
        return np.inf
    # The joint solution deviates from the known rig with the covariance of the corners plus `systematic`.
    white = (directions[:, both] / np.sqrt(reduction[both])).T @ inverse
    widths = np.linalg.eigvalsh(np.eye(int(both.sum())) + white @ systematic @ white.T)
    factor = float(np.sum(widths**2) / np.sum(widths))
    return factor * float(scipy.special.chdtri(float(np.sum(widths)) ** 2 / float(np.sum(widths**2)), 1 - _SIGNIFICANT))


def _amount(amount: float, unit: str) -> str:
    """A change in words."""
    return f"{amount:.2g}{' ' if unit not in ('', '°') else ''}{unit}"


def _differences_from(rig: KnownRig, apart: CornerFit, free: Bools) -> str:
    """The same between the known rig and the independent fit."""
    variance = rig.covariance.diagonal() + covariance_of(apart.information, free).diagonal()[:SHARED]
    return _differences(rig.step_to(apart.state), variance)


def _differences(step: Floats, variance: Floats) -> str:
    """The parameters that differ by most sigmas, in words, by a step (21,) with its variance (21,)."""
    sigmas = np.abs(step) / np.sqrt(np.maximum(variance, 1e-18))
    rows = []
    for name, columns, unit, _ in _ROWS:
        chosen = list(columns)
        worst = float(sigmas[chosen].max())
        size = float(np.linalg.norm(step[chosen])) * _FACTORS.get(unit, 1.0)
        rows.append((worst, f"{name} by {_amount(size, unit)} ({worst:.1f} sigmas)"))
    rows.sort(reverse=True)
    return ", ".join(text for _, text in rows[:_NAMED])
