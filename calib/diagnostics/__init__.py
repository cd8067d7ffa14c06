"""What an estimate is worth: uncertainty, degenerate views, the verdict of the numbers, the next best view."""

from calib.diagnostics.acceptance import USEFUL_SIGMA, no_corner, refuse_degenerate, refuse_untrustworthy
from calib.diagnostics.notes import FURTHER_CAPTURE, notes_on
from calib.diagnostics.uncertainty import Uncertainty, calibration_of, sigmas_by_name, uncertainty_of
