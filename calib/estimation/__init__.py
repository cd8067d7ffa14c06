"""Estimation: likelihood of matches on planes, its noise, waves of surfaces, smooth errors, and scores."""

from calib.estimation.flatness import covariance_of_waves, modes_over
from calib.estimation.likelihood import CONVERGED, Fit, Joint, Layout, evaluate, minimise, squareness
from calib.estimation.noise import UNKNOWN, NoiseLevels, block_inflation, blocks_of, measured, of_station, rough_levels
from calib.estimation.plane_association import WRONG_ASSOCIATION, association_scores, plane_scores, separate_plane
from calib.estimation.scores import PatchSums, Score, reweighted, score
from calib.estimation.smooth_errors import covariance_of_shifts
