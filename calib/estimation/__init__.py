"""Estimation: likelihood of matches on planes, its noise, waves of surfaces, smooth errors, and scores."""

from calib.estimation.likelihood import CONVERGED, Fit, Joint, Layout, evaluate, minimise, squareness
from calib.estimation.noise import UNKNOWN, NoiseLevels, block_inflation, blocks_of, measured, of_station, rough_levels
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
