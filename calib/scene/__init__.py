"""Calibration from anything rigid: stations of an unchanged rig, without a corner or a board."""

from calib.scene.adjustment import FEWEST_STATIONS
from calib.scene.calibrate import (
    BY_SCENE,
    SceneCalibration,
    calibrate_scene,
    recalibrate_scene,
)
from calib.scene.drift import DRIFTED, drift_findings
from calib.scene.given_calibration import CALIBRATION_CHANGED, LineTest, compare_with_lines, find_change
from calib.scene.next_station import NextStation
from calib.scene.refusals import ONE_AXIS, TOO_FEW_STATIONS
