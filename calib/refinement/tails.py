"""A heavy-tailed prior: a mixture of a narrow and a wide Gaussian."""

import numpy as np

from calib.numerics import Floats

# One in twenty comes from the wide Gaussian, whose standard deviation is four times as large.
_ODD, _TIMES = 0.05, 4.0


def with_tails(z: Floats) -> tuple[Floats, Floats, Floats]:
    """Return −2 log of a mixture of a Gaussian of sigma 1 and a wide one, 0 at its peak, for deviations (n, d).

    The d deviations of a row come from the same Gaussian: where one wall of a corner is far off, the others may be too.
    The cost (n, d) of a row is shared out evenly. Also return half its derivative, and half its second derivatives or
    that of the wide Gaussian if larger, both (n, d). The prior is nearly Gaussian up to three sigmas;
    beyond, the data outweigh it.
    """
    size, least = z.shape[1], _TIMES**-2.0
    narrow, wide = np.log(1 - _ODD), np.log(_ODD) - size * np.log(_TIMES)
    square = np.sum(z**2, axis=1, keepdims=True)
    usual, odd = narrow - square / 2, wide - least * square / 2
    total = np.logaddexp(usual, odd)
    share = np.exp(odd - total)  # the probability of belonging to the wide Gaussian
    weight = 1 - share * (1 - least)
    curvature = weight - share * (1 - share) * (z * (1 - least)) ** 2
    cost = 2 * (np.logaddexp(narrow, wide) - total) / size
    return np.broadcast_to(cost, z.shape), weight * z, np.maximum(curvature, least)
