"""Whether a projector scales its picture in one direction, so that its pixels are not square.

The model has square pixels. A picture that is 1 % wider than high is explained by walls that are off square, with focal
lengths that are wrong by a tenth and sigmas of a hundredth. So a second model, with an aspect, is weighed against the
first by its evidence.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats, huber_weights
from calib.refinement.alternatives import alternative
from calib.refinement.likelihood import ROBUST_SIGMAS, Fit, Prior
from calib.refinement.match_cells import Cells
from calib.refinement.parameters import predict

# Pictures that are scaled in one direction, and remain so unnoticed: one in a hundred, by about 2 %.
_PROBABILITY, _SPREAD = 0.01, 0.02


@dataclass(frozen=True)
class PictureScale:
    """`aspect`: width over height of the projector's pixels, less 1, with its `sigma`, if they are not square.
    `probability` that they are not. `response` (size,): change of the solution for an aspect of 1.
    """

    aspect: float
    sigma: float
    probability: float
    response: Floats

    @property
    def covariance(self) -> Floats:
        """What the other model adds to the covariance (size, size) around the solution with square pixels."""
        mean_square = self.aspect**2 + self.sigma**2
        return self.probability * mean_square * np.outer(self.response, self.response)


def picture_scale(captures: Sequence[Cells], fit: Fit, prior: Prior, variances: Sequence[Floats]) -> PictureScale:
    """Weigh pixels that are not square. `variances`: (M,) for each capture, of each coordinate of each cell."""
    size = fit.state.size
    information, gradient = np.zeros((size + 1, size + 1)), np.zeros(size + 1)
    information[:size, :size], gradient[:size] = fit.information, fit.gradient
    information[size, size] = _SPREAD**-2.0
    for i, (cells, residual, variance) in enumerate(zip(captures, fit.residuals, variances, strict=True)):
        predicted, jacobian, _ = predict(fit.state, cells.camera_px, cells.plane, i)
        by_aspect = predicted[:, 0] - fit.state.projector[1]
        deviation = np.linalg.norm(residual, axis=1) / np.sqrt(variance)
        weighted = huber_weights(deviation, ROBUST_SIGMAS) / variance * by_aspect
        gradient[size] += weighted @ residual[:, 0]
        information[size, size] += weighted @ by_aspect
        columns = fit.state.columns(i)
        np.add.at(information[size], columns, weighted @ jacobian[:, 0])
        information[columns, size] = information[size, columns]
    other = alternative(information, gradient, np.append(prior.free, False), size, _PROBABILITY, _SPREAD)
    return PictureScale(other.value, other.sigma, other.odds / (1 + other.odds), other.response[:size])
