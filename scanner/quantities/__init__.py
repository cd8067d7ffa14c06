"""Numbers with units and names, as every page, table and file shows them."""

from scanner.quantities.calibration_numbers import (
    FACE_NAMES,
    Quantity,
    calibration_table,
    device_names,
    device_quantities,
    empty_table,
    intrinsic_errors_percent,
    percent,
    plain,
    pose_quantities,
    relative_focal_sigmas,
    rig_quantities,
    truth_line,
)
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
