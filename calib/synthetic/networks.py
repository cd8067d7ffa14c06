"""Several cameras and projectors in a synthetic room, all facing one corner: matches of each pair.

As in `calib.synthetic.rooms`, the projector's rays are intersected with walls and boxes, visible points are projected
into the camera, and noise is added to the projector's pixels.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calib.geometry import Intrinsics, Matches, Pose
from calib.numerics import Floats, Ints
from calib.synthetic.captures import inside, jittered_grid, look_at
from calib.synthetic.rooms import (
    RoomOptions,
    SyntheticScene,
    cast,
    is_free,
    on_waves,
    random_box,
    random_walls,
    random_waves,
)

_CORNER = (0, 2, 4)  # the floor, and the walls at x = 0 and y = 0
_APART_M = 0.5
_ATTEMPTS = 500
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class SyntheticNetwork:
    """`captures`: matches of each (camera, projector), labelled 0, 1, 2 on the corner's faces, 3 and up on others.

    `devices`, `poses`: ground truth by name, X_room = rotation X_device + translation, in metres. `scene`: the room.
    """

    captures: Mapping[tuple[str, str], Matches]
    devices: Mapping[str, Intrinsics]
    poses: Mapping[str, Pose]
    scene: SyntheticScene

    @property
    def planes(self) -> tuple[Floats, Floats]:
        """Normals (P, 3) and offsets (P,) of the planes, by label: normal · X = offset."""
        normals, offsets = (np.concatenate(parts) for parts in zip(*self.scene.solids, strict=True))
        order = _by_label(len(offsets))
        return normals[order], offsets[order]


def random_network(
    rng: np.random.Generator, cameras: int, projectors: int, options: RoomOptions | None = None
) -> SyntheticNetwork:
    """Devices `camera1`, …, `projector1`, … Raises ValueError if no room is found where all see the corner."""
    options = options or RoomOptions(boxes=2, count=40_000)
    names = [*(f"camera{i + 1}" for i in range(cameras)), *(f"projector{i + 1}" for i in range(projectors))]
    for _ in range(_ATTEMPTS):
        solids = [random_walls(rng, options), *(random_box(rng, options) for _ in range(options.boxes))]
        waves = random_waves(rng, options) if options.wavy else np.zeros((6, 1, 5))
        scene = SyntheticScene(solids, np.zeros((0, 4)), waves)
        devices = {
            name: _varied(rng, options.camera if i < cameras else options.projector) for i, name in enumerate(names)
        }
        poses = _poses(rng, names, scene, options)
        captures = {
            (camera, projector): _seen(rng, options, scene, (devices[camera], devices[projector]), poses[camera], at)
            for camera in names[:cameras]
            for projector in names[cameras:]
            for at in (poses[projector],)
        }
        least = options.least_share * options.count
        if all(matches.on_each_face.min() > 5 * least for matches in captures.values()):
            return SyntheticNetwork(captures, devices, poses, scene)
    raise ValueError("no room in which every pair sees the corner")


def with_turned_camera(network: SyntheticNetwork, pair: tuple[str, str], turn: Floats) -> SyntheticNetwork:
    """The camera of a pair was turned before that capture was taken, by a rotation vector (3,) in radians, in its own
    frame.
    """
    camera, matches = network.devices[pair[0]], network.captures[pair]
    pixels = camera.project(Rotation.from_rotvec(turn).apply(camera.unproject(matches.camera_px)))
    turned = replace(matches, camera_px=pixels)[inside(pixels, camera)]
    return replace(network, captures={**network.captures, pair: turned})


def _varied(rng: np.random.Generator, device: Intrinsics) -> Intrinsics:
    focal = device.focal_px[0] * float(np.exp(rng.normal(0, 0.1)))
    x, y = (float(value) for value in np.array(device.principal_point_px) + rng.normal(0, 15, 2))
    k1, k2, p1, p2, k3 = device.distortion
    return replace(
        device,
        focal_px=(focal, focal),
        principal_point_px=(x, y),
        distortion=(k1 + float(rng.normal(0, 0.02)), k2, p1, p2, k3),
    )


def _poses(rng: np.random.Generator, names: list[str], scene: SyntheticScene, options: RoomOptions) -> dict[str, Pose]:
    poses: dict[str, Pose] = {}
    for name in names:
        while name not in poses:
            eye = np.array(options.size) * rng.uniform((0.4, 0.4, 0.35), (0.9, 0.9, 0.85))
            near = any(np.linalg.norm(eye - pose.translation) < _APART_M for pose in poses.values())
            if near or not is_free(eye, scene):
                continue
            rotation = look_at(eye, rng.uniform(0.1, 0.6, 3), _UP, rng.normal(0, 0.05))
            poses[name] = Pose(rotation.T, eye)
    return poses


def _seen(
    rng: np.random.Generator,
    options: RoomOptions,
    scene: SyntheticScene,
    pair: tuple[Intrinsics, Intrinsics],
    camera_at: Pose,
    projector_at: Pose,
) -> Matches:
    camera, projector = pair
    pixels = jittered_grid(rng, projector, options.count)
    rays = projector_at.rotate(projector.unproject(pixels))
    points, plane = cast(rays, projector_at.translation, scene)
    points = on_waves(points, plane, rays, scene.solids[0][0], scene.waves)
    camera_px = camera.project(camera_at.undo(points))
    visible = inside(camera_px, camera)
    visible[visible] = cast(points[visible] - camera_at.translation, camera_at.translation, scene)[1] == plane[visible]
    label = np.argsort(_by_label(6 * len(scene.solids)))[plane[visible]].astype(np.int32)
    noisy = pixels[visible] + rng.normal(0, options.noise_px, (len(label), 2))
    return Matches(camera_px[visible], noisy, label)


def _by_label(count: int) -> Ints:
    """The number in the scene of each label's plane."""
    return np.array([*_CORNER, *(i for i in range(count) if i not in _CORNER)])
