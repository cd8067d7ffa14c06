"""How well both devices see the corner, by the criteria of an operator who chooses the place of the rig."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Floats, Ints
from hw.simulated.device import PlacedDevice
from hw.simulated.illumination import ProjectorLight
from hw.simulated.scene import Label, Scene

_CAMERA_STEP_PX = 34  # at the paper's 2448 × 2048
_PROJECTOR_STEP_PX = 20  # at the paper's 854 × 480


@dataclass(frozen=True)
class ViewCriteria:
    """Criteria of one view of the corner.

    `label_shares` (6,): shares of the camera's directly lit pixels by `Label`. `lit_share`: share of the camera's
    pixels that are directly lit. `picture_in_frame`: share of the projector's rays that end inside the camera's image,
    occluded or not. `baseline_out_of_face`: the smallest sine of the angle between the baseline and a face. `forward`:
    absolute cosine between the baseline and the camera's axis. `grazing`: the smallest sine of the angle between a face
    and a device's ray to the vertex. `clearance_m`: the smallest distance between a device and a face. `vertex_hidden`:
    furniture occludes the vertex from the camera. `sphere_lit`: share of the camera's sphere pixels that are directly
    lit; NaN without a sphere.
    """

    label_shares: Floats
    lit_share: float
    picture_in_frame: float
    baseline_out_of_face: float
    forward: float
    grazing: float
    clearance_m: float
    vertex_hidden: bool
    sphere_lit: float

    def is_suitable(self, smallest_face: float) -> bool:
        """Whether the operator's guide would recommend the view.

        Each face has at least the share `smallest_face` of the lit pixels and is seen at 17° or more. The picture is
        inside the camera's image. The baseline is inclined to each face by 11° or more, and to the camera's axis by 60°
        or more.
        """
        return (
            float(self.label_shares[:3].min()) >= smallest_face
            and self.lit_share >= 0.06
            and self.picture_in_frame >= 0.985
            and self.baseline_out_of_face >= 0.2
            and self.forward <= 0.5
            and self.grazing >= 0.3
            and self.clearance_m >= 0.6
        )


def look(scene: Scene, camera: PlacedDevice, projector: PlacedDevice) -> ViewCriteria:
    """Evaluate a view with a coarse grid of rays from both devices."""
    _, surface, lit = seen(scene, camera, projector)
    label = scene.labels[surface]
    shares = np.bincount(label[lit], minlength=len(Label)) / max(int(lit.sum()), 1)

    directions = projector.rays(_grid(projector, _PROJECTOR_STEP_PX))
    t, _ = scene.cast(projector.centre[:, None], directions)
    landed, _ = camera.project(projector.centre[:, None] + t * directions)

    normals = scene.normals(np.arange(3, dtype=np.int32), np.zeros((3, 3)))
    centres = np.stack([camera.centre, projector.centre], axis=1)
    heights = normals.T @ centres
    baseline = projector.centre - camera.centre
    baseline = baseline / np.linalg.norm(baseline)
    of_sphere = label == Label.SPHERE
    return ViewCriteria(
        label_shares=shares,
        lit_share=float(lit.mean()),
        picture_in_frame=float(camera.optics.sees(landed).mean()),
        baseline_out_of_face=float(np.abs(normals.T @ baseline).min()),
        forward=float(abs(camera.rotation[2] @ baseline)),
        grazing=float((heights / np.linalg.norm(centres, axis=0)).min()),
        clearance_m=float(heights.min()),
        vertex_hidden=bool(scene.occluded(np.zeros((3, 1)), camera.centre)[0]),
        sphere_lit=float(lit[of_sphere].mean()) if of_sphere.any() else float("nan"),
    )


def seen(scene: Scene, camera: PlacedDevice, projector: PlacedDevice) -> tuple[Floats, Ints, Bools]:
    """Points (3, n) hit by a coarse grid of camera rays, their surfaces (n,), and whether they are lit (n,)."""
    directions = camera.rays(_grid(camera, _CAMERA_STEP_PX))
    t, surface = scene.cast(camera.centre[:, None], directions)
    points = camera.centre[:, None] + t * directions
    _, irradiance = ProjectorLight(scene, projector).direct(surface, points)
    return points, surface, irradiance > 0


def lit_and_visible(
    scene: Scene, camera: PlacedDevice, projector: PlacedDevice, surface: Ints, points: Floats
) -> Bools:
    """Whether points (3, n) on surfaces (n,) are both lit and seen by a rig, (n,)."""
    _, irradiance = ProjectorLight(scene, projector).direct(surface, points)
    pixels, _ = camera.project(points)
    facing = np.sum(scene.normals(surface, points) * (camera.centre[:, None] - points), axis=0) > 0
    visible: Bools = (irradiance > 0) & camera.optics.sees(pixels) & facing
    visible[visible] = ~scene.occluded(points[:, visible], camera.centre)
    return visible


def _grid(device: PlacedDevice, step_px: int) -> Floats:
    x, y = np.meshgrid(
        np.arange(step_px // 2, device.optics.width, step_px), np.arange(step_px // 2, device.optics.height, step_px)
    )
    return np.stack([x.ravel(), y.ravel()]).astype(np.float64)
