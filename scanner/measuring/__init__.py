"""Spheres, faces and distances measured in the cloud of a result."""

from scanner.measuring.acceptance import Acceptance, Error, errors_of, parse_ball_bar
from scanner.measuring.acceptance_report import (
    ACCEPTANCE_FILE,
    ACCEPTANCE_PAGE,
    acceptance_findings,
    summary_table,
    write_acceptance,
    write_acceptance_page,
)
from scanner.measuring.document import MEASURE_FILE, write_document
from scanner.measuring.figure import FIGURE_FILE, write_figure
from scanner.measuring.measure import PixelPlace, measure, measure_pixels, read_scene
from scanner.measuring.measurements import (
    AngleMeasurement,
    DistanceMeasurement,
    FaceMeasurement,
    MeasuredScene,
)
from scanner.measuring.network_points import NetworkPoints, has_matches
from scanner.measuring.placed_points import PlacedPoints, PointNumber
from scanner.measuring.planes import measure_scene, one_in_each_cell, sample_cells
from scanner.measuring.scene_errors import rig_errors
from scanner.measuring.section_files import (
    SECTION_FILES,
    write_section_dxf,
    write_section_svg,
    write_section_table,
)
from scanner.measuring.sections import Contour, cut
from scanner.measuring.table import angle_cells, shares_table, tables
