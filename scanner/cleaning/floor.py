"""The floor of a cloud as its origin: z up, x to the right of the newest camera, which is above the origin."""

import numpy as np

from calib.deferred_imports import open3d
from calib.geometry import Pose
from calib.numerics import Floats
from scanner.errors import InputError

KNOWN_UP_DEG, CAMERA_UP_DEG = 20.0, 60.0  # how far the floor may be from level: by the room, by a tilted camera
_SAMPLE = 50_000
_TRIALS = 1000
_FEWEST = 100
_THICK = 0.005  # of the cloud's extent


def floor_axes(points: Floats, normals: Floats, up: Floats, within_deg: float, eye: Pose) -> Pose:
    """X_floor = pose @ X of points (N, 3) with normals; `up` (3,) is upwards within so many degrees, `eye` the
    camera's pose, X = eye @ X_camera. Raises InputError if there is no floor.
    """
    steep = np.cos(np.radians(within_deg))
    level = points[normals @ up > steep]
    below = level[(level - eye.translation) @ up < 0]
    if len(below) < _FEWEST:
        raise InputError(
            f"no floor is found: expected {_FEWEST} points or more on a level surface below the camera, found "
            f"{len(below)}; give three points with --axes instead"
        )
    o3d = open3d()
    o3d.utility.random.seed(0)
    some = below[:: max(1, len(below) // _SAMPLE)]
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(some))
    thick = _THICK * float(np.linalg.norm(np.ptp(points, axis=0)))
    _, on = cloud.segment_plane(thick, 3, _TRIALS)
    floor = some[np.asarray(on, np.int64)]
    middle = floor.mean(axis=0)
    z = np.linalg.svd(floor - middle, full_matrices=False)[2][2]
    z = z if z @ up > 0 else -z
    x = eye.rotation[:, 0] - (eye.rotation[:, 0] @ z) * z
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    origin = eye.translation - ((eye.translation - middle) @ z) * z
    return Pose(rotation, -rotation @ origin)
