"""Spheres, faces and distances measured in the cloud of a result."""

from scanner.measuring.acceptance import (
    ACCEPTANCE_FILE,
    ACCEPTANCE_PAGE,
    Acceptance,
    Error,
    acceptance_findings,
    errors_of,
    parse_ball_bar,
    summary_table,
    write_acceptance,
    write_acceptance_page,
)
from scanner.measuring.document import MEASURE_FILE, angle_cells, shares_table, tables, write_document
from scanner.measuring.figure import FIGURE_FILE, write_figure
from scanner.measuring.measure import PixelPlace, measure, measure_pixels, read_scene
from scanner.measuring.measurements import (
    AngleMeasurement,
    DistanceMeasurement,
    FaceMeasurement,
    MeasuredScene,
    rig_errors,
)
from scanner.measuring.placed_points import NetworkPoints, PlacedPoints, PointNumber, has_matches
from scanner.measuring.planes import measure_scene, one_in_each_cell, sample_cells
from scanner.measuring.sections import (
    SECTION_FILES,
    Contour,
    cut,
    write_section_dxf,
    write_section_svg,
    write_section_table,
)
