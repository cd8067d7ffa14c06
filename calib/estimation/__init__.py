"""Estimation: problems of maximum likelihood, noise of their matches, waves of surfaces, smooth errors, and scores."""

from calib.estimation.noise import UNKNOWN, NoiseLevels, block_inflation, blocks_of, measured, of_station, rough_levels
from calib.estimation.problem import CONVERGED, Fit, Joint, Part, Problem, Term, add_up, squareness
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
from calib.estimation.systematic_errors import covariance_of_shifts, covariance_of_waves, modes_over
