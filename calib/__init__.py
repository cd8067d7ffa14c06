"""Geometry of a camera and a projector that look at the corner of a room: arrays in, arrays out.

The names below are what other programs use; each is imported when it is first asked for. docs/api.md shows them all.
"""

from typing import TYPE_CHECKING

from calib.deferred_imports import defer_imports

if TYPE_CHECKING:
    from calib.diagnostics import Uncertainty as Uncertainty
    from calib.finding import Finding as Finding
    from calib.finding import FindingKind as FindingKind
    from calib.finding import Severity as Severity
    from calib.geometry import Calibration as Calibration
    from calib.geometry import Corner as Corner
    from calib.geometry import DeviceSigmas as DeviceSigmas
    from calib.geometry import Intersections as Intersections
    from calib.geometry import Intrinsics as Intrinsics
    from calib.geometry import Matches as Matches
    from calib.geometry import Pose as Pose
    from calib.geometry import Sigmas as Sigmas
    from calib.geometry import intersect as intersect
    from calib.plane_segmentation import Faces as Faces
    from calib.plane_segmentation import find_faces as find_faces
    from calib.pointcloud import Cloud as Cloud
    from calib.pointcloud import build_cloud as build_cloud
    from calib.pointcloud import point_covariances as point_covariances
    from calib.refusal import RefusalError as RefusalError
    from calib.self_calibration import PrincipalPoint as PrincipalPoint
    from calib.self_calibration import SelfCalibration as SelfCalibration
    from calib.self_calibration import calibrate_photos as calibrate_photos
    from calib.self_calibration import self_calibrate as self_calibrate
    from calib.self_calibration import self_calibrate_jointly as self_calibrate_jointly

__all__, __getattr__, __dir__ = defer_imports(
    __name__,
    {
        "diagnostics": "Uncertainty",
        "finding": "Finding FindingKind Severity",
        "geometry": "Calibration Corner DeviceSigmas Intersections Intrinsics Matches Pose Sigmas intersect",
        "plane_segmentation": "Faces find_faces",
        "pointcloud": "Cloud build_cloud point_covariances",
        "refusal": "RefusalError",
        "self_calibration": "PrincipalPoint SelfCalibration calibrate_photos self_calibrate self_calibrate_jointly",
    },
)
