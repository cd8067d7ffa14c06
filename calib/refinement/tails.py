"""A prior with tails: what is mostly small, and now and then several times as large as usual."""

import numpy as np

from calib.numerics import Floats

# One in twenty deviates otherwise than the rest, by four times as much (one standard deviation).
_ODD, _TIMES = 0.05, 4.0
_PEAK = np.log(1 - _ODD + _ODD / _TIMES)


def with_tails(z: Floats) -> tuple[Floats, Floats, Floats]:
    """−2 log of the mixture of a Gaussian of sigma 1 and a wide one, 0 at its peak, for deviations (n,).

    Then half its derivative, and half its second derivative, or that of the wide one where this is larger. Within three
    sigmas it is all but the Gaussian; from there on what the data say weighs more.
    """
    least = _TIMES**-2.0
    usual, odd = np.log(1 - _ODD) - z**2 / 2, np.log(_ODD / _TIMES) - least * z**2 / 2
    total = np.logaddexp(usual, odd)
    share = np.exp(odd - total)  # the probability of being one of the odd ones
    weight = 1 - share * (1 - least)
    curvature = weight - share * (1 - share) * (z * (1 - least)) ** 2
    return 2 * (_PEAK - total), weight * z, np.maximum(curvature, least)
