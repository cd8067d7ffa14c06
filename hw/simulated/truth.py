"""Ground truth of a simulated room, for tests and for the summary. The simulated devices do not reveal it."""

from dataclasses import dataclass, replace

import numpy as np

from calib.geometry import Calibration, Intrinsics
from calib.numerics import Floats, Ints
from hw.simulated.device import Optics, PlacedDevice
from hw.simulated.illumination import ProjectorLight
from hw.simulated.renderer import Renderer
from hw.simulated.room import DrawnRoom

_RECTANGULAR = 1e-9  # rounding error of entries that are zero


@dataclass(frozen=True)
class GroundTruth:
    """Ground truth at the centre of each camera pixel.

    `projector_px` (H, W, 2): the projector pixel that lights it directly; NaN in shadow and outside the picture.
    `points_m` (H, W, 3): the surface point in the camera's frame. `label` (H, W): the `Label` of the surface.
    `direct_share` (H, W): direct light over all light of a white picture.
    """

    projector_px: Floats
    points_m: Floats
    label: Ints
    direct_share: Floats


def true_calibration(room: DrawnRoom, homography: Floats | None = None) -> Calibration | None:
    """The calibration of a room's rig, in metres; None if no pinhole projector gives the picture.

    `homography` (3, 3): from the picture's pixels to those of the projector's panel.
    """
    projector = _intrinsics(room.projector.optics)
    if homography is not None:
        reshaped = _reshaped(projector, homography)
        if reshaped is None:
            return None
        projector = reshaped
    return replace(calibration_between(room.camera, room.projector), projector=projector)


def calibration_between(camera: PlacedDevice, projector: PlacedDevice) -> Calibration:
    """The calibration of two devices, in metres."""
    pose = projector.pose.inverse() @ camera.pose
    return Calibration(_intrinsics(camera.optics), _intrinsics(projector.optics), pose, unit="m")


def _reshaped(panel: Intrinsics, homography: Floats) -> Intrinsics | None:
    """Intrinsics of a projector whose picture is scaled; None if it is mirrored or no longer a rectangle."""
    (a, b, x), (c, d, y), (e, f, g) = homography.tolist()
    if max(map(abs, (b, c, e, f))) > _RECTANGULAR or a <= 0 or d <= 0:
        return None
    (fx, fy), (x0, y0) = panel.focal_px, panel.principal_point_px
    return replace(panel, focal_px=(g * fx / a, g * fy / d), principal_point_px=((g * x0 - x) / a, (g * y0 - y) / d))


def true_view(room: DrawnRoom, renderer: Renderer) -> GroundTruth:
    """Ground truth of every camera pixel, by a ray through its centre."""
    optics = room.camera.optics
    x, y = np.meshgrid(np.arange(optics.width), np.arange(optics.height))
    directions = room.camera.rays(np.stack([x.ravel(), y.ravel()]))
    t, surface = room.scene.cast(room.camera.centre[:, None], directions)
    along = t * directions
    points = room.camera.centre[:, None] + along
    pixels, irradiance = ProjectorLight(room.scene, room.projector).direct(surface, points)
    picture = renderer.picture.to_picture(pixels)
    projector = room.projector.optics
    lit = (irradiance > 0) & projector.sees(pixels) & projector.sees(picture)

    light = np.ones((renderer.picture.height, renderer.picture.width), np.float32)
    direct = renderer.direct(light).astype(np.float64)
    shape = (optics.height, optics.width)
    return GroundTruth(
        np.where(lit, picture, np.nan).T.reshape(*shape, 2),
        (room.camera.rotation @ along).T.reshape(*shape, 3),
        room.scene.labels[surface].reshape(shape),
        direct / (direct + renderer.indirect(light) + renderer.ambient),
    )


def _intrinsics(optics: Optics) -> Intrinsics:
    return Intrinsics(
        optics.width,
        optics.height,
        (optics.focal_px, optics.focal_px),
        optics.principal_point_px,
        (optics.k1, optics.k2, 0.0, 0.0, 0.0),
    )
