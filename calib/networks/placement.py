"""A device that is not placed yet, from points that it sees: direct linear transform, or homography of a wall."""

import numpy as np

from calib.closed_form import resected
from calib.geometry import Pose, Size, homography_between, nearest_depths, project, unproject
from calib.networks.network import Device
from calib.numerics import Floats

_USUAL_FOCAL = 1.2  # image widths
_FOCALS = 0.3, 4.0  # of ordinary devices, in image widths
_OFF = 0.05  # of the image's width: a device that sees known points further off is not there


def triangulated(camera: Device, projector: Device, camera_px: Floats, projector_px: Floats) -> Floats:
    """Points (N, 3) of a network on the camera's rays, where these are nearest to the projector's."""
    rays, back = (
        device.pose.rotate(unproject(device.lens, pixels)[0])
        for device, pixels in ((camera, camera_px), (projector, projector_px))
    )
    depth = nearest_depths(rays, back, camera.pose.translation - projector.pose.translation)[0]
    return camera.pose.translation + depth[:, None] * rays


def placed(points: Floats, pixels: Floats, size: Size) -> Device | None:
    """A device, without lens terms, that sees points (N, 3) at pixels (N, 2); None of points on one plane."""
    solution = resected(points, pixels)
    if solution is None:
        return None
    matrix, into_device = solution
    lens = np.array([np.sqrt(matrix[0, 0] * matrix[1, 1]), *matrix[:2, 2], 0.0, 0.0, 0.0, 0.0, 0.0])
    return Device(lens, into_device.inverse(), size)


def placed_before_wall(points: Floats, pixels: Floats, size: Size, point_px: tuple[float, float]) -> Device | None:
    """The same of points that are nearly on one plane, with square pixels and the principal point where it is expected.

    Both axes of the plane are perpendicular and of one length before the device (Zhang, "A flexible new technique for
    camera calibration", 2000). Where that tells no likely focal length, as straight before a wall, it is a usual one.
    """
    centre = points.mean(axis=0)
    _, spreads, axes = np.linalg.svd(points - centre, full_matrices=False)
    if not spreads[1] > 0:
        return None
    spread = float(spreads[0]) / np.sqrt(len(points))
    frame = np.stack([axes[0], axes[1], np.cross(axes[0], axes[1])], axis=1)
    homography = homography_between((points - centre) @ frame[:, :2] / spread, pixels - point_px) / size.width
    homography[2] *= size.width  # of pixels in image widths
    (one, other, _) = homography.T
    by_focal = np.array([one[:2] @ other[:2], one[:2] @ one[:2] - other[:2] @ other[:2]])
    rest = np.array([one[2] * other[2], one[2] ** 2 - other[2] ** 2])
    inverse_square = -float(by_focal @ rest) / max(float(by_focal @ by_focal), 1e-300)
    focal = inverse_square**-0.5 if inverse_square > 0 else np.inf
    if not _FOCALS[0] < focal < _FOCALS[1]:
        focal = _USUAL_FOCAL
    before = homography / np.array([[focal], [focal], [1.0]])
    before *= np.sign(before[2, 2]) / np.sqrt(np.linalg.norm(before[:, 0]) * np.linalg.norm(before[:, 1]))
    left, _, right = np.linalg.svd(np.column_stack([before[:, 0], before[:, 1], np.cross(before[:, 0], before[:, 1])]))
    back = frame @ (left @ right).T
    lens = np.array([focal * size.width, *point_px, 0.0, 0.0, 0.0, 0.0, 0.0])
    return Device(lens, Pose(back, centre - spread * (back @ before[:, 2])), size)


def sees(device: Device, points: Floats, pixels: Floats) -> bool:
    """Whether a device has known points (N, 3) about where they are seen, (N, 2)."""
    predicted, _, _ = project(device.lens, device.pose.undo(points))
    return bool(np.median(np.linalg.norm(predicted - pixels, axis=1)) < _OFF * device.size.width)
