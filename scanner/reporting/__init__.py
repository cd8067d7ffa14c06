"""The parts of the report: its input, the verdict, the numbers, the pictures, the plots."""

from scanner.reporting.calibration_history import history_svg
from scanner.reporting.contents import CaptureRow, JointCaptures, ReportInput
from scanner.reporting.page import VIEWER, write_report
from scanner.reporting.plots import HEIGHT, WIDTH, Plot, Scale
from scanner.reporting.sections import PageImage, ScaledMap, extent_row, files_beside, picture
from scanner.reporting.verdict import verdict
from scanner.reporting.view3d import (
    CAMERA_COLOUR,
    PROJECTOR_COLOUR,
    Thinned,
    View3d,
    device_lines,
    looking,
    turning_view,
)
