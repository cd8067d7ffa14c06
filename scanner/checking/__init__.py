"""A check of a rig before a scan, in seconds: devices, light, lenses, and how well this view will calibrate."""

from scanner.checking.calibration_check import CalibrationCheck, check_calibration, config_of, take_capture
from scanner.checking.calibration_update import CalibrationUpdate, refuse_no_update, update_calibration
from scanner.checking.check import check_configured_rig
from scanner.checking.devices import opened
from scanner.checking.document import write_check
from scanner.checking.exposure import propose_exposure
from scanner.checking.light import Light, photograph_light
from scanner.checking.report import CheckReport, CheckRow, CheckState, table_of
from scanner.checking.response import measure_ramp
