"""Numerics without geometry: arrays, compiled loops, tiles and threads, samples, robust and nonlinear fits, bases."""

from calib.numerics.arrays import WHOLE, Bools, Floats, Floats32, Image, Ints, Part, Window, Words, by_columns, grey
from calib.numerics.jit import compiled, inlined
from calib.numerics.least_squares import (
    NIELSEN,
    Damping,
    Minimum,
    Quadratic,
    covariance_of,
    descend,
    inverse_of,
    minimise,
    newton,
    singular_refused,
)
from calib.numerics.polynomials import (
    CONIC,
    CUBIC,
    LEVEL,
    SLOPE,
    TERMS,
    by_pixel,
    coefficients_of,
    monomials,
    normalisation,
    orthonormal,
    orthonormal_polynomials,
    scaling_about,
)
from calib.numerics.robust import (
    MEDIAN_LENGTH,
    SIGMA_PER_MEDIAN,
    HuberFit,
    biweight,
    biweight_slope,
    blocks,
    clustered_scatter,
    fit_huber,
    fit_reweighted,
    huber_loss,
    huber_weights,
    influence_on,
    median,
    medians,
    quantile,
    robust_covariance,
    robust_sigma,
    robust_sigmas,
)
from calib.numerics.sampling import (
    ENOUGH_PIXELS,
    MANY_PIXELS,
    SEED,
    TRIAL_PIXELS,
    at_random,
    chosen_ones,
    distinct,
    evenly,
    evenly_spread,
    lines_of,
)
from calib.numerics.tiling import (
    STRIP_ROWS,
    around,
    in_parallel,
    in_pieces,
    in_slices,
    in_tiles,
    processors,
    slices_of,
    use_processors,
    widened,
)
