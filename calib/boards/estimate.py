"""The maximum-likelihood estimate of a rig from views of a board, with its noise measured."""

from collections.abc import Sequence
from dataclasses import dataclass

from calib.boards.likelihood import BoardVariances, BoardView, Fit, Prior, minimise
from calib.boards.noise import measured
from calib.boards.parameters import SHARED, State
from calib.numerics import Floats
from calib.refinement import Noise, covariance_of

_ROUNDS = 60  # rounds; a dozen are usual
_SETTLED = 0.01  # relative change of a variance between rounds


@dataclass(frozen=True)
class Estimate:
    """The fit of some views, with the noise of its residuals.

    `corner_px`: for each view, the standard deviation of each coordinate of its corners. `noise`: of its matches.
    `covariance` (SHARED, SHARED) of the common parameters.
    """

    views: tuple[BoardView, ...]
    fit: Fit
    prior: Prior
    levels: BoardVariances
    corner_px: Floats
    noise: tuple[Noise, ...]
    covariance: Floats

    @property
    def state(self) -> State:
        """The most likely one."""
        return self.fit.state


def estimate(views: Sequence[BoardView], start: State, prior: Prior, levels: BoardVariances) -> Estimate:
    """Estimate from a start near the minimum; `levels` are an initial guess of the noise.

    State and noise are estimated alternately until both converge; the result does not depend on the guess.
    """
    fit = minimise(views, start, prior, levels)
    for _ in range(_ROUNDS):
        before = levels
        levels, corner_px, noise = measured(views, fit, prior)
        fit = minimise(views, fit.state, prior, levels)
        if levels.change(before) < _SETTLED:
            break
    covariance = covariance_of(fit.information, prior.free(fit.state))[:SHARED, :SHARED]
    return Estimate(tuple(views), fit, prior, levels, corner_px, noise, covariance)
