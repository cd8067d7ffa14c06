"""Geometry of a camera and a projector that look at the corner of a room: arrays in, arrays out.

The names below are what other programs use; each is imported when it is first asked for. docs/api.md shows them all.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calib.diagnostics import Uncertainty as Uncertainty
    from calib.geometry import Calibration as Calibration
    from calib.geometry import Corner as Corner
    from calib.geometry import DeviceSigmas as DeviceSigmas
    from calib.geometry import Intersections as Intersections
    from calib.geometry import Intrinsics as Intrinsics
    from calib.geometry import Matches as Matches
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

_HOMES = {
    "diagnostics": "Uncertainty",
    "geometry": "Calibration Corner DeviceSigmas Intersections Intrinsics Matches Sigmas intersect",
    "plane_segmentation": "Faces find_faces",
    "pointcloud": "Cloud build_cloud point_covariances",
    "refusal": "RefusalError",
    "self_calibration": "PrincipalPoint SelfCalibration calibrate_photos self_calibrate self_calibrate_jointly",
}
_HOME = {name: home for home, names in _HOMES.items() for name in names.split()}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'calib' has no attribute '{name}'")
    return getattr(import_module(f"calib.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
