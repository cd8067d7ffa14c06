"""Judges an estimate: uncertainty, degenerate views, acceptance tests, the next best view."""

from calib.diagnostics.acceptance import (
    FROM_ONE_PLACE,
    USEFUL_SIGMA,
    no_corner,
    refuse_degenerate,
    refuse_untrustworthy,
)
from calib.diagnostics.comparison import Difference, compare
from calib.diagnostics.contradiction import (
    RIG_CHANGED,
    ContradictionError,
    RigChange,
    explain_change,
    refuse_changed_rig,
    refuse_contradiction,
)
from calib.diagnostics.error_propagation import (
    Budget,
    LinearFit,
    Spread,
    SystematicErrors,
    length_in_the_middle,
    spread_of_fit,
    spread_of_points,
    spread_of_vertex,
    stacked,
)
from calib.diagnostics.findings import FURTHER_CAPTURE, WORTH_A_CAPTURE, findings_on_solution
from calib.diagnostics.next_best_view import NextView, best_next_view, moved_corner, step_taken
from calib.diagnostics.pose_errors import PoseErrors, budget_across
from calib.diagnostics.sheet_size import SheetSize, size_of_sheet
from calib.diagnostics.spatial_errors import (
    PlaneForm,
    SpatialCorrelation,
    footprint_offsets,
    plane_form,
    spatial_correlation,
)
from calib.diagnostics.uncertainty import (
    NOWHERE,
    Along,
    Uncertainty,
    along_valley,
    calibration_of,
    moved_calibration,
    sigmas_of,
    uncertainty_of,
    with_pixels_of,
)
