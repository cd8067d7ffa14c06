"""Fits under priors whose scale is not known: a mixture of Gaussians, one for each combination of populations.

Lenses and walls of which nothing is said come from one of several populations. To first order around a fit, the
posterior of each combination is Gaussian, with an evidence E_k in closed form (Bishop, Pattern Recognition and Machine
Learning, 2006, 3.4). With the share w_k of its evidence, times how common it is, the mixture's prior has the variance
Σ w_k σ_k². The fit under a Gaussian of this variance has the covariance of the mixture: of directions that no match
determines it is exactly that, and where matches determine a column its prior does not count.

One capture measures the difference of camera and projector in p1 and p2, say, but hardly their mean. The difference
tells the scale, and the scale how far the mean may be off.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from calib.numerics import Floats, Ints, inverse_of
from calib.refinement.likelihood import CornerFit, CornerProblem, Prior
from calib.refinement.parameters import TANGENTIAL_TERMS, State
from calib.refinement.profile_minimiser import minimise

_ROUNDS = 2  # of estimating scales at a fit, and fitting with them
_LESS_EVIDENCE = 2.0  # in −2 log of it
_SETTLED = 0.1  # relative change of all scales that is worth no further fit


@dataclass(frozen=True, eq=False)
class WeighedFit:
    """A minimum and what speaks for it."""

    fit: CornerFit
    problem: CornerProblem
    """The fit's; its prior has the scales that the data make likely."""
    cost: float
    """−2 log of the evidence of the columns of populations, at the best of all others, under the fit's prior, and of
    how common its scales are. Without populations the fit's cost."""


def weigh(problem: CornerProblem, start: State) -> WeighedFit:
    """Minimise from a state under the mixture of all populations of a problem's prior."""
    fit, prior = minimise(problem, start), problem.prior
    if not prior.populations or not np.isfinite(fit.cost):
        return WeighedFit(fit, problem, fit.cost)
    columns = _columns(prior)
    lenses = [population for population in prior.populations if np.isin(population.columns, TANGENTIAL_TERMS).all()]
    for scales in dict.fromkeys(tuple(lens.sigmas) for lens in lenses):
        fit, prior = _likeliest_scale(problem.under(prior), fit, scales)
    likeliest = WeighedFit(fit, problem.under(prior), _evidence(fit, prior))
    for _ in range(_ROUNDS):
        sigma = mix_scales(fit, prior)
        settled = bool(np.all(np.abs(sigma / prior.sigma[columns] - 1) < _SETTLED))
        prior = prior.with_sigmas(columns, sigma).without_tails(columns)
        fit = minimise(problem.under(prior), fit.state)
        if settled:
            break
    mixed = WeighedFit(fit, problem.under(prior), _evidence(fit, prior))
    # What is extrapolated from a fit under a wide prior may lead to another minimum, of less evidence.
    is_narrower = bool(np.all(prior.sigma[columns] <= likeliest.problem.prior.sigma[columns]))
    chosen = likeliest if is_narrower and mixed.cost > likeliest.cost + _LESS_EVIDENCE else mixed
    return replace(chosen, cost=chosen.cost + _rarity(chosen.problem.prior))


def _rarity(prior: Prior) -> float:
    """−2 log of how common the scales of a prior are in its populations."""
    common = [
        np.interp(np.log(prior.sigma[population.columns[0]]), np.log(population.sigmas), population.shares)
        for population in prior.populations
    ]
    return float(-2 * np.sum(np.log(common)))


def _likeliest_scale(problem: CornerProblem, fit: CornerFit, scales: Sequence[float]) -> tuple[CornerFit, Prior]:
    """The fit, and its prior, with that of the scales (K,) that has the most evidence for all populations of these.

    Fits go from scale to scale, from `fit` up and down: minima move farther than evidence can be extrapolated.
    """
    populations = [population for population in problem.prior.populations if tuple(population.sigmas) == scales]
    columns = np.concatenate([population.columns for population in populations])
    usual = int(np.argmin(np.abs(np.log(np.array(scales) / problem.prior.sigma[columns[0]]))))
    trials: list[tuple[float, CornerFit, Prior]] = []
    for path in (range(usual, len(scales)), range(usual - 1, -1, -1)):
        state = fit.state
        for k in path:
            prior = problem.prior.with_sigmas(columns, scales[k]).without_tails(columns)
            trial = minimise(problem.under(prior), state)
            common = sum(float(np.log(population.shares[k])) for population in populations)
            trials.append((_evidence(trial, prior) - 2 * common, trial, prior))
            state = trial.state
    _, best, prior = min(trials, key=lambda trial: trial[0])
    return best, prior


def _evidence(fit: CornerFit, prior: Prior) -> float:
    """−2 log of the evidence of the columns of populations, at the best of all others."""
    matrix, _ = _seen(fit, prior)
    return fit.cost + float(np.linalg.slogdet(_scaled(matrix, prior.sigma[_columns(prior)]))[1])


def _columns(prior: Prior) -> Ints:
    """Those of all populations, (d,)."""
    return np.concatenate([population.columns for population in prior.populations])


def mix_scales(fit: CornerFit, prior: Prior) -> Floats:
    """Standard deviations (d,) of the columns of all populations.

    With the precisions Λ of a combination, −2 log E = c − log det Λ + log det (M + Λ) − bᵀ (M + Λ)⁻¹ b.
    """
    matrix, pull = _seen(fit, prior)
    counts = [len(population.columns) for population in prior.populations]
    combinations = list(product(*(population.sigmas for population in prior.populations)))
    sigmas = np.repeat(combinations, counts, axis=1)
    pulls = sigmas * pull
    scaled = _scaled(matrix, sigmas)
    explained = np.einsum("ki,ki->k", pulls, np.linalg.solve(scaled, pulls[:, :, None])[:, :, 0])
    common = [np.prod(shares) for shares in product(*(population.shares for population in prior.populations))]
    log_evidence = (explained - np.linalg.slogdet(scaled)[1]) / 2 + np.log(common)
    share = np.exp(log_evidence - np.logaddexp.reduce(log_evidence))
    variance: Floats = share @ sigmas**2
    return np.sqrt(variance)


def _seen(fit: CornerFit, prior: Prior) -> tuple[Floats, Floats]:
    """What the data say of the columns q of all populations, qᵀ M q − 2 bᵀ q: M (d, d) and b (d,).

    All other columns are integrated out.
    """
    columns = _columns(prior)
    nuisance = prior.free.copy()
    nuisance[columns] = False
    values = fit.state.additive()
    _, slope, curvature = prior.misfit(values)
    gradient, information = fit.gradient.copy(), fit.information.copy()
    gradient[columns] -= slope[columns]
    information[columns, columns] -= curvature[columns]
    gain = inverse_of(information[np.ix_(nuisance, nuisance)]) @ information[np.ix_(nuisance, columns)]
    matrix = _non_negative(
        information[np.ix_(columns, columns)] - gain.T @ information[np.ix_(nuisance, columns)], prior.sigma[columns]
    )
    return matrix, matrix @ (values - prior.mean)[columns] - (gradient[columns] - gain.T @ gradient[nuisance])


def _scaled(matrix: Floats, sigmas: Floats) -> Floats:
    """1 + S M S (…, d, d), the information in units of a prior's sigmas (…, d), well conditioned.

    Its determinant is the square of the prior's volume over the posterior's.
    """
    scaled: Floats = np.eye(len(matrix)) + sigmas[..., :, None] * matrix * sigmas[..., None, :]
    return scaled


def _non_negative(matrix: Floats, unit: Floats) -> Floats:
    """A symmetric matrix (d, d) without the negative eigenvalues that rounding leaves, of columns in `unit` (d,)."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2 * np.outer(unit, unit))
    clipped: Floats = (vectors * np.maximum(values, 0.0)) @ vectors.T / np.outer(unit, unit)
    return clipped
