"""Comparison of calibrations and of surfaces, where they differ and by how many sigmas; and clouds in one frame."""

from scanner.comparing.comparison import (
    CalibrationComparison,
    NamedCalibration,
    Sheet,
    compare_calibrations,
    compare_files,
)
from scanner.comparing.page import COMPARE_FILE, COMPARE_PAGE, write_compare, write_compare_page
from scanner.comparing.registering import (
    REGISTER_FILE,
    REGISTERED_FILE,
    RegisteredClouds,
    register_clouds,
    registration_rows,
    registration_verdict,
    write_registered_cloud,
    write_registration,
)
from scanner.comparing.summary import comparison_verdict, headings, rows, table
from scanner.comparing.surface_comparison import Conformity, SurfaceComparison, compare_surfaces
from scanner.comparing.surface_files import (
    CLOUD_FILE,
    MESH_FILE,
    REFERENCE_CLOUD_FILE,
    REFERENCE_MESH_FILE,
    deviation_mesh,
    reference_mesh,
    write_deviation_cloud,
    write_deviation_mesh,
    write_reference_cloud,
    write_surface_document,
    write_surface_page,
)
from scanner.comparing.surface_summary import quantile_rows, region_table, surface_verdict
