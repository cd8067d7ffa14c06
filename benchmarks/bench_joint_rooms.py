"""Three captures of each of several simulated rooms, calibrated jointly without prior knowledge, and merged.

    python benchmarks/bench_joint_rooms.py --seeds 0 1 2 3 4

All light transport is on, the default sequence is shown, the rig sees the corner from its poses 0, 1 and 2. The
walls are off square by 0.3 degrees (normal, each angle), which is the prior of the calibration; of the camera's
principal point it knows only the image's centre. 'calibration' is the mean absolute error of (f_c, f_p, x_p, y_p); it
is also given for each capture alone. 'each cloud' compares the points with the true ones in the camera's frame,
'merged' the merged cloud with the true surfaces in the true corner's frame, both relative to the distance from the
camera, the baseline being known; 'agreement' is the distance between the captures' surfaces.
"""

import argparse
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from bench_rooms import cloud_error, decoded
from scipy.spatial import cKDTree

from calib.geometry import Corner, Matches
from calib.numerics import Floats
from calib.plane_segmentation import find_faces
from calib.pointcloud import Cloud, CornerView, MergedCloud, build_cloud, find_order, merged
from calib.refusal import RefusalError
from calib.self_calibration import PrincipalPoint, SelfCalibration, self_calibrate, self_calibrate_jointly
from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedRoom
from scanner.quantities import intrinsic_errors_percent
from scanner.reconstruction import brightness, consistency

WALLS_OFF_DEG = 0.3
CENTRE_SIGMA_OF_WIDTH = 0.03
Size = tuple[int, int]


@dataclass(frozen=True)
class Captured:
    room: SimulatedRoom
    matches: Matches
    texture: np.ndarray


def captured(seed: int, pose: int, camera_size: Size, projector_size: Size) -> Captured:
    settings = SimulatedRigSettings(seed=seed, pose=pose, walls_off_deg=WALLS_OFF_DEG)
    room = SimulatedRoom(settings, camera_size, projector_size)
    decoding = decoded(room, projector_size)
    return Captured(room, find_faces(decoding.matches, camera_size, projector_size).matches, decoding.texture)


def true_surfaces(room: SimulatedRoom) -> tuple[Floats, Floats]:
    """Points (N, 3) and normals (N, 3) in the world seen by the camera."""
    optics, camera = room.room.camera.optics, room.room.camera
    x, y = np.meshgrid(np.arange(optics.width), np.arange(optics.height))
    directions = camera.rays(np.stack([x.ravel(), y.ravel()]))
    t, surface = room.room.scene.cast(camera.centre[:, None], directions)
    points = camera.centre[:, None] + t * directions
    return points.T, room.room.scene.normals(surface, points).T


def merged_error(cloud: MergedCloud, views: list[CornerView], captures: list[Captured], baseline_m: float) -> Floats:
    """Distances of the merged points from the nearest true surface, relative to that from the nearest camera, (N,)."""
    edges = captures[0].room.room.scene.room.edges
    camera = captures[0].room.room.camera
    true_legs = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    corner = Corner(np.zeros(3), true_legs)
    true = CornerView(views[0].points, None, views[0].camera, corner)
    # Both frames lie along the same legs; the first capture determines their order.
    axes = np.roll(views[0].axes, cloud.turns[0], axis=0) @ camera.rotation
    turn = next(turn for turn in range(3) if np.trace(np.roll(true.axes, turn, axis=0) @ axes.T) > 2)
    in_world = true.in_camera(cloud.points.astype(np.float64) * baseline_m, turn)
    points, normals = (np.concatenate(parts) for parts in zip(*(true_surfaces(c.room) for c in captures), strict=True))
    nearest = cKDTree(points).query(in_world)[1]
    off = np.abs(np.sum((in_world - points[nearest]) * normals[nearest], axis=1))
    centres = np.stack([capture.room.room.camera.centre for capture in captures])
    share: Floats = off / np.min(np.linalg.norm(in_world[:, None] - centres, axis=2), axis=1)
    return share


def merge(
    captures: list[Captured], found: tuple[SelfCalibration, ...]
) -> tuple[MergedCloud, list[Cloud], list[CornerView]]:
    clouds, views = [], []
    for capture, solution in zip(captures, found, strict=True):
        clouds.append(build_cloud(solution.matches, capture.texture, solution.calibration))
        camera = solution.calibration.camera
        views.append(CornerView(clouds[-1].points, brightness(capture.texture), camera, solution.corner))
    order = find_order(views)
    if not order.decided:
        raise ValueError(f"the order of the faces is not decided: {order}")
    return merged(clouds, views, order.turns), clouds, views


def run(seed: int, camera_size: Size, projector_size: Size) -> dict[str, float]:
    start = time.perf_counter()
    captures = [captured(seed, pose, camera_size, projector_size) for pose in (0, 1, 2)]
    print(f"seed {seed}: {sum(len(c.matches) for c in captures)} matches after {time.perf_counter() - start:.0f} s")
    truth = captures[0].room.calibration
    width, height = camera_size
    point = PrincipalPoint(((width - 1) / 2, (height - 1) / 2), CENTRE_SIGMA_OF_WIDTH * width)
    known: dict[str, Any] = {"principal_point": point, "squareness_deg": WALLS_OFF_DEG}
    for pose, capture in enumerate(captures):
        try:
            alone = self_calibrate(capture.matches, camera_size, projector_size, **known)
            print(f"  capture {pose} alone: {np.abs(intrinsic_errors_percent(alone.calibration, truth)).mean():.2f} %")
        except RefusalError as refusal:
            print(f"  capture {pose} alone: refused. {refusal.reason}")
    start = time.perf_counter()
    found = self_calibrate_jointly([c.matches for c in captures], camera_size, projector_size, **known)
    seconds = time.perf_counter() - start
    errors = intrinsic_errors_percent(found[0].calibration, truth)
    figures = {"calibration": float(np.abs(errors).mean())}
    print(
        f"  calibration: {figures['calibration']:.3f} % ({', '.join(f'{error:+.3f}' for error in errors)}), "
        f"after {seconds:.0f} s"
    )
    figures["each cloud"] = 100 * float(
        np.mean(
            [
                cloud_error(solution.matches, solution, capture.room.ground_truth(), truth.baseline)
                for capture, solution in zip(captures, found, strict=True)
            ]
        )
    )
    cloud, clouds, views = merge(captures, found)
    off = merged_error(cloud, views, captures, truth.baseline)
    figures["merged"] = 100 * float(np.median(off))
    figures["agreement"] = 100 * float(np.median(consistency(clouds, views, cloud.turns)))
    print(
        f"  points: each cloud {figures['each cloud']:.3f} %, merged {figures['merged']:.3f} % "
        f"(95 % below {100 * np.percentile(off, 95):.3f} %), agreement {figures['agreement']:.3f} %",
        flush=True,
    )
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--camera", type=int, nargs=2, default=[1224, 1024])
    parser.add_argument("--projector", type=int, nargs=2, default=[854, 480])
    options = parser.parse_args()
    rooms = [run(seed, tuple(options.camera), tuple(options.projector)) for seed in options.seeds]
    for name in rooms[0]:
        values = [room[name] for room in rooms]
        print(f"{name:11} mean {np.mean(values):.3f} %, worst {np.max(values):.3f} %, {len(values)} rooms")


if __name__ == "__main__":
    main()
