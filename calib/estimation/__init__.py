"""Estimation: cells of matches, problems of maximum likelihood, noise, waves of surfaces, smooth errors, and scores."""

from calib.estimation.match_cells import Cells, follow_one_plane, into_cells, joined
from calib.estimation.noise import (
    UNKNOWN,
    Noise,
    NoiseLevels,
    block_inflation,
    blocks_of,
    long_waves,
    measured,
    noise_of,
    of_station,
    overdispersion,
    rough_levels,
)
from calib.estimation.priors import ColumnPrior, Population
from calib.estimation.problem import CONVERGED, ROBUST_SIGMAS, Fit, Joint, Part, Problem, Term, add_up, squareness
from calib.estimation.scores import (
    WRONG_ASSOCIATION,
    PatchSums,
    Score,
    association_scores,
    plane_scores,
    reweighted,
    score,
    separate_plane,
)
from calib.estimation.systematic_errors import (
    Shift,
    Shifts,
    covariance_of_shifts,
    covariance_of_waves,
    modes_over,
    pull_of_shifts,
    smooth_fields,
)
