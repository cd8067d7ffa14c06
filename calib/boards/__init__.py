"""Calibration from a printed board in several poses: maximum likelihood over corners and matches, and its honesty."""

from calib.boards.acceptance import FEWEST_VIEWS, BoardCoverage, ray_sigmas
from calib.boards.as_rig import rig_uncertainty
from calib.boards.calibrate import Board, BoardCalibration, OutlierView, calibrate_boards
from calib.boards.estimate import Estimate, Halves, Prediction
from calib.boards.likelihood import BoardView
from calib.boards.next_pose import NextPose, best_next_pose
from calib.boards.parameters import INTRINSIC_COLUMNS, State, predict_corners, predict_matches
