"""From matches to a calibration with its uncertainty: of a rig, and of one camera by its photos."""

from calib.self_calibration.known_calibration import KnownCalibration
from calib.self_calibration.photos import anywhere, calibrate_photos
from calib.self_calibration.rig import (
    Method,
    PrincipalPoint,
    Profile,
    SelfCalibration,
    paper_trials,
    self_calibrate,
    self_calibrate_jointly,
)
