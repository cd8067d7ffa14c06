"""Numerics without geometry: array types, compiled loops, chunks and threads, robust statistics, least squares."""

from calib.numerics.array_types import Bools, Floats, Image, Ints
from calib.numerics.chunks import by_columns, in_pieces
from calib.numerics.differences import by_pixel
from calib.numerics.grey_levels import grey
from calib.numerics.jit import compiled, inlined
from calib.numerics.levenberg_marquardt import NIELSEN, Damping, Minimum, Quadratic, descend, minimise, newton
from calib.numerics.morans_i import SpatialCorrelation, spatial_correlation
from calib.numerics.parallel import in_parallel, in_slices, processors, slices_of, use_processors
from calib.numerics.reweighted import reweighted
from calib.numerics.robust_statistics import (
    MEDIAN_LENGTH,
    SIGMA_PER_MEDIAN,
    biweight,
    biweight_slope,
    blocks,
    influence_on,
    median,
    quantile,
    robust_covariance,
    robust_sigma,
)
from calib.numerics.sampling import evenly
from calib.numerics.singular import singular_refused
