"""Linear least squares, iteratively reweighted: the fit that outliers lose."""

from collections.abc import Callable

import numpy as np

from calib.numerics.array_types import Floats

_SINGULAR = 1e-10  # of a normal matrix: where terms are nearly dependent, the solution of minimum norm is taken


def reweighted(terms: Floats, values: Floats, weigh: Callable[[Floats], Floats], weight: Floats, rounds: int) -> Floats:
    """Coefficients (P,) with `values` (N,) ≈ coefficients @ `terms` (P, N); (P, K) for several `values` (K, N).

    Begins with `weight` (N,); `weigh` gives the next round's weights for the residuals, shaped like the values, that
    the last one left.
    """
    for _ in range(rounds):
        weighted = terms * weight
        coefficients: Floats = np.asarray(np.linalg.lstsq(weighted @ terms.T, weighted @ values.T, rcond=_SINGULAR)[0])
        weight = weigh(values - coefficients.T @ terms)
    return coefficients
