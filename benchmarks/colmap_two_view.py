"""COLMAP's solution of two views through pycolmap: relative pose, points, bundle adjustment.

COLMAP logs every adjustment on stderr.
"""

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.geometry import Calibration, Intrinsics, Matches, Pose, intersect

HAS_COLMAP = importlib.util.find_spec("pycolmap") is not None
# COLMAP's initial focal length of an unknown camera, relative to the longer side of its image.
FOCAL_OF_LONGER_SIDE = 1.2
_HALF_PX = 0.5  # COLMAP's first pixel centre is at (0.5, 0.5)


def unknown_focal(width: int, height: int, principal_point_px: Sequence[float]) -> Intrinsics:
    """A pinhole with the initial focal length of COLMAP."""
    focal = FOCAL_OF_LONGER_SIDE * max(width, height)
    return Intrinsics(width, height, (focal, focal), (float(principal_point_px[0]), float(principal_point_px[1])))


@dataclass(frozen=True)
class TwoViews:
    """A reconstruction of two views; `one_camera`: both are by one camera."""

    model: Any
    sizes: tuple[tuple[int, int], tuple[int, int]]
    one_camera: bool

    def adjust(self, *, free_principal_point: bool) -> None:
        """Bundle adjustment over poses, points and focal lengths, and principal points if free (of all cameras)."""
        import pycolmap

        options = pycolmap.BundleAdjustmentOptions()
        options.refine_focal_length, options.refine_principal_point = True, free_principal_point
        options.refine_extra_params = False
        options.print_summary = False
        pycolmap.bundle_adjustment(self.model, options)

    @property
    def calibration(self) -> Calibration:
        """Calibration in units of the baseline. Raises ValueError if the adjustment diverged."""
        numbers = (1, 1) if self.one_camera else (1, 2)
        first, second = (
            _from_colmap(size, self.model.cameras[number].params)
            for size, number in zip(self.sizes, numbers, strict=True)
        )
        poses = [self.model.images[number].cam_from_world() for number in (1, 2)]
        motion = poses[1] * poses[0].inverse()
        translation = np.asarray(motion.translation)
        return Calibration(first, second, Pose(motion.rotation.matrix(), translation / np.linalg.norm(translation)))


def two_views(matches: Matches, first: Intrinsics, second: Intrinsics | None) -> TwoViews | None:
    """Pose and points of two given pinholes; None if COLMAP finds no pose. `second` None: the first."""
    import pycolmap

    pycolmap.set_random_seed(0)
    one_camera, other = second is None, second or first
    cameras = [_to_colmap(pycolmap, device, number) for number, device in enumerate((first, other), start=1)]
    cameras = cameras[:1] * 2 if one_camera else cameras
    pixels = [matches.camera_px + _HALF_PX, matches.projector_px + _HALF_PX]
    pairs = np.stack([np.arange(len(matches))] * 2, axis=1).astype(np.uint32)
    geometry = pycolmap.estimate_calibrated_two_view_geometry(cameras[0], pixels[0], cameras[1], pixels[1], pairs)
    if not pycolmap.estimate_two_view_geometry_pose(cameras[0], pixels[0], cameras[1], pixels[1], geometry):
        return None
    motion = geometry.cam2_from_cam1
    met = intersect(matches, Calibration(first, other, Pose(motion.rotation.matrix(), np.asarray(motion.translation))))
    model = pycolmap.Reconstruction()
    for camera in cameras[:1] if one_camera else cameras:
        model.add_camera_with_trivial_rig(camera)
    for number, (seen, pose) in enumerate(zip(pixels, (pycolmap.Rigid3d(), motion), strict=True), start=1):
        camera_id = cameras[number - 1].camera_id
        image = pycolmap.Image(name=str(number), keypoints=seen[met.in_front], camera_id=camera_id, image_id=number)
        model.add_image_with_trivial_frame(image, pose)
    for i, point in enumerate(met.points[met.in_front]):
        track = pycolmap.Track([pycolmap.TrackElement(1, i), pycolmap.TrackElement(2, i)])
        model.add_point3D(point, track)
    return TwoViews(model, (first.size, other.size), one_camera)


def _to_colmap(pycolmap: Any, device: Intrinsics, number: int) -> Any:
    parameters = [device.focal_px[0], *(coordinate + _HALF_PX for coordinate in device.principal_point_px)]
    return pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=device.width, height=device.height, params=parameters, camera_id=number
    )


def _from_colmap(size: tuple[int, int], parameters: Sequence[float]) -> Intrinsics:
    focal, x, y = (float(value) for value in parameters)
    return Intrinsics(*size, (focal, focal), (x - _HALF_PX, y - _HALF_PX))
