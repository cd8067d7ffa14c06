"""Calibration from anything rigid: stations of an unchanged rig, without a corner or a board."""

from calib.scene.calibrate import SceneCalibration, calibrate_scene
