"""A heavy-tailed prior: a mixture of a narrow and a wide Gaussian."""

import numpy as np

from calib.numerics import Floats

# One in twenty comes from the wide Gaussian, whose standard deviation is four times as large.
_ODD, _TIMES = 0.05, 4.0
_PEAK = np.log(1 - _ODD + _ODD / _TIMES)


def with_tails(z: Floats) -> tuple[Floats, Floats, Floats]:
    """Return −2 log of a mixture of a Gaussian of sigma 1 and a wide one, 0 at its peak, for deviations (n,).

    Also return half its derivative, and half its second derivative or that of the wide Gaussian if larger. Within three
    sigmas the prior is nearly Gaussian; beyond, the data outweigh it.
    """
    least = _TIMES**-2.0
    usual, odd = np.log(1 - _ODD) - z**2 / 2, np.log(_ODD / _TIMES) - least * z**2 / 2
    total = np.logaddexp(usual, odd)
    share = np.exp(odd - total)  # the probability of belonging to the wide Gaussian
    weight = 1 - share * (1 - least)
    curvature = weight - share * (1 - share) * (z * (1 - least)) ** 2
    return 2 * (_PEAK - total), weight * z, np.maximum(curvature, least)
