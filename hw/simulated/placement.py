"""The geometry of the rig, random camera poses in front of the corner, and how well both devices see it from there.

A view is judged by the criteria of an operator who chooses the place of the rig.
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.numerics import Bools, Floats, Ints
from hw.simulated.device import Optics, PlacedDevice
from hw.simulated.illumination import ProjectorLight
from hw.simulated.scene import Label, Scene

# The paper's rig (section 5.1), at its full camera resolution.
_PAPER_CAMERA = Optics(2448, 2048, 1791.1, (1256.3, 1054.3))
_PAPER_PROJECTOR = Optics(854, 480, 1247.3, (377.1, 234.0))
# A throw ratio of 0.74, which lights half a wall from the middle of a room.
SHORT_THROW = Optics(854, 480, 630.0, (419.0, 262.0))
_ROLL_DEG = 15.0
_ZOOMS = (1.0, 1.06, 0.95, 1.03)


@dataclass(frozen=True)
class RigGeometry:
    """Both devices at the paper's resolution, and X_projector = rotation X_camera + translation."""

    camera: Optics
    projector: Optics
    rotation: Floats
    translation: Floats

    def placed(self, camera_rotation: Floats, camera_centre: Floats) -> tuple[PlacedDevice, PlacedDevice]:
        """Camera and projector in the room, given the camera's rotation from the world (3, 3) and centre (3,)."""
        projector_rotation = self.rotation @ camera_rotation
        projector_centre = camera_centre - projector_rotation.T @ self.translation
        return (
            PlacedDevice(self.camera, camera_rotation, camera_centre),
            PlacedDevice(self.projector, projector_rotation, projector_centre),
        )


def draw_rig(rng: np.random.Generator, distortion: float, projector: Optics = _PAPER_PROJECTOR) -> RigGeometry:
    """The paper's intrinsics, or those of another projector, with random lens distortion.

    The devices are 0.3 to 0.6 m apart and converge at 2.2 to 3.2 m, with a roll of up to 8°.

    Distortion is that of ordinary machine-vision and projector lenses: up to 4 % in the camera's corners and 0.5 % in
    the projector's.
    """
    bearing = rng.uniform(0, 2 * np.pi)
    centre = np.array([np.cos(bearing), np.sin(bearing), rng.uniform(-0.4, 0.4)])
    centre *= rng.uniform(0.3, 0.6) / np.linalg.norm(centre)
    target = np.array([0.0, 0.0, rng.uniform(2.2, 3.2)]) + rng.uniform(-0.05, 0.05, 3)
    rotation = look_at(centre, target, np.array([0.0, -1.0, 0.0]), rng.uniform(-8, 8))
    camera_k1, camera_k2 = distortion * rng.uniform((-0.06, -0.005), (-0.01, 0.01))
    projector_k1, projector_k2 = distortion * rng.uniform((-0.03, -0.01), (0.01, 0.01))
    return RigGeometry(
        _with_lens(_PAPER_CAMERA, _PAPER_CAMERA.width, _PAPER_CAMERA.height, camera_k1, camera_k2),
        _with_lens(projector, projector.width, projector.height, projector_k1, projector_k2),
        rotation,
        -rotation @ centre,
    )


def draw_camera_pose(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Rotation from the world (3, 3) and centre (3,) of a camera on a tripod that looks down into the corner."""
    distance, azimuth, elevation = rng.uniform((2.0, 27.0, 25.0), (3.4, 63.0, 43.0))
    azimuth, elevation = np.radians([azimuth, elevation])
    centre = distance * np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    target = rng.uniform(-0.1, 0.35, 3)
    return look_at(centre, target, np.array([0.0, 0.0, 1.0]), rng.uniform(-_ROLL_DEG, _ROLL_DEG)), centre


def resized(optics: Optics, width: int, height: int) -> Optics:
    """The same optics with an image of another size. Focal length and principal point scale with its width."""
    return _with_lens(optics, width, height, optics.k1, optics.k2)


def zoomed(device: PlacedDevice, number: int) -> PlacedDevice:
    """The device of a network at pose `number`, with a focal length different from its neighbours'."""
    optics = device.optics
    return replace(device, optics=replace(optics, focal_px=_ZOOMS[number % len(_ZOOMS)] * optics.focal_px))


def _with_lens(optics: Optics, width: int, height: int, k1: float, k2: float) -> Optics:
    scale = width / optics.width
    x0, y0 = optics.principal_point_px
    return Optics(width, height, scale * optics.focal_px, (scale * x0, scale * y0), float(k1), float(k2))


def look_at(centre: Floats, target: Floats, up: Floats, roll_deg: float) -> Floats:
    """Rotation (3, 3) from the world into the frame (x right, y down, z forward) of a device at `centre` facing
    `target`.
    """
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cosine, sine = np.cos(np.radians(roll_deg)), np.sin(np.radians(roll_deg))
    return np.stack([cosine * right + sine * down, cosine * down - sine * right, forward])


_CAMERA_STEP_PX = 34  # at the paper's 2448 × 2048
_PROJECTOR_STEP_PX = 20  # at the paper's 854 × 480


@dataclass(frozen=True)
class ViewCriteria:
    """Criteria of one view of the corner."""

    label_shares: Floats
    """Shares of the camera's directly lit pixels by `Label`, (6,)."""
    lit_share: float
    """Share of the camera's pixels that are directly lit."""
    picture_in_frame: float
    """Share of the projector's rays that end inside the camera's image, occluded or not."""
    baseline_out_of_face: float
    """The smallest sine of the angle between the baseline and a face."""
    forward: float
    """Absolute cosine between the baseline and the camera's axis."""
    grazing: float
    """The smallest sine of the angle between a face and a device's ray to the vertex."""
    clearance_m: float
    """The smallest distance between a device and a face."""
    vertex_hidden: bool
    """Furniture occludes the vertex from the camera."""
    sphere_lit: float
    """Share of the camera's sphere pixels that are directly lit; NaN without a sphere."""

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
