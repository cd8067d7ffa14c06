"""Calibrate a rig from matches, or one camera from photos, with uncertainty."""

from calib.refinement import PrincipalPoint
from calib.self_calibration.known_calibration import KnownCalibration
from calib.self_calibration.photos import anywhere, calibrate_photos
from calib.self_calibration.result import Method, Profile, SelfCalibration, paper_trials
from calib.self_calibration.rig import self_calibrate, self_calibrate_jointly
