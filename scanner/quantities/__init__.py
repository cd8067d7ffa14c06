"""Numbers with units and names, as every page, table and file shows them."""

from scanner.quantities.calibration_numbers import (
    FACE_NAMES,
    Quantity,
    device_names,
    device_quantities,
    intrinsic_errors_percent,
    percent,
    plain,
    pose_quantities,
    relative_focal_sigmas,
    rig_quantities,
)
from scanner.quantities.calibration_table import calibration_table, empty_table, truth_line
from scanner.quantities.units import (
    METRES,
    UNKNOWN_UNIT,
    ShownUnit,
    fine_unit,
    metres_per,
    parse_coordinates,
    parse_length,
    parse_seconds,
    shown_unit,
    unit_name,
)
