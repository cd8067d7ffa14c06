"""Whole rooms: registration without an initial guess, one estimate of rig, poses and walls, and their errors.

    python benchmarks/bench_room.py [--rooms 6] [--stations 6] [--camera 612 512] [--first 0] [--without 2]
        [--changed 3] [--pictures]

Simulated furnished rooms, walls off square by 0.3°, furniture rotated by 4°, two balls 3 m apart. Matches come from
rays, one per camera pixel, with 0.03 projector px of noise; the camera's principal point is only known to be near the
image's centre. Stations are in random order. Pose errors are the largest after aligning the whole room with the truth;
a station off by more than 20 mm is wrong. Surface errors are those of the room's cloud, from the nearest true surface,
and of single pixels of the stations, from their true points, which is the noise of a match. `--without`: leave one
station out, so that the chain is open. `--changed`: the projector was rotated in the rig before this station, by 0.3 to
1° about any axis. `--pictures`: stations have pictures of the lit scene. Seconds are of one processor: start is
calibrating from corners, solve is surfaces, registration, estimate and final clouds.
"""

import argparse
import resource
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from room_truth import centres_apart, from_surfaces
from scipy.spatial.transform import Rotation

from calib.geometry import Pose, Size
from calib.numerics import Floats
from calib.refusal import RefusalError
from hw.errors import DeviceError
from scanner.capture import CaptureMetadata
from scanner.configuration import Config
from scanner.results import Decoded, GivenMatches
from scanner.rooms import SolvedRoom, blended, floor_plan, rig_from_stations, solve_room
from scanner.ui import Terminal

sys.path.append(str(Path(__file__).parents[1]))
from tests.support.whole_room import PROJECTOR, TrueStation, stations, with_turned_projector

_BALLS_M, _RADIUS_M = 3.0, 0.12
_PRIOR_OF_WIDTH = 35 / 612
_TURNED_DEG = (0.3, 1.0)


@dataclass(frozen=True)
class Row:
    """One room: errors in mm and degrees; surface errors of the cloud and of pixels, median and 95 %, relative to the
    diagonal in per cent; errors over sigmas.
    """

    joined: int
    stations: int
    wrong: int
    place_mm: float
    turn_deg: float
    cloud_percent: Floats
    pixels_percent: Floats
    balls_mm: float
    in_sigmas: list[float]
    lengths_in_sigmas: list[float]
    focal_percent: float
    outlier_stations: list[str]
    start_s: float
    solve_s: float


def config_of(true: Sequence[TrueStation], camera: Size) -> Config:
    principal_point = {"prior": "centre", "sigma_px": _PRIOR_OF_WIDTH * camera.width}
    return Config.model_validate(
        {
            "camera": {"width": camera.width, "height": camera.height, "principal_point": principal_point},
            "projector": {"width": PROJECTOR[0], "height": PROJECTOR[1]},
            "scale": {"baseline_m": true[0].calibration.baseline},
        }
    )


def measure(true: Sequence[TrueStation], camera: Size) -> Row:
    config, quiet = config_of(true, camera), Terminal(quiet=True)
    metadata = CaptureMetadata(camera, Size(*PROJECTOR))
    captures = [
        Decoded(metadata, each.matches, GivenMatches(each.picture, smooth_px=0.0), str(number))
        for number, each in enumerate(true)
    ]
    began = time.process_time()
    start = rig_from_stations(captures, config, quiet)
    started = time.process_time()
    room = solve_room(captures, start, config, quiet)
    ended = time.process_time()
    return judged(room, true, started - began, ended - started)


def any_turn(seed: list[int]) -> Floats:
    """A random rotation vector in degrees (3,)."""
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    turn: Floats = rng.uniform(*_TURNED_DEG) * axis / np.linalg.norm(axis)
    return turn


def judged(room: SolvedRoom, true: Sequence[TrueStation], start_s: float, solve_s: float) -> Row:
    truth = [true[k] for k in room.group.stations]
    # The gauge of the sigmas is the first station; errors are evaluated in the best overall frame.
    found = np.array([station.place.translation for station in room.stations])
    centres = np.array([each.place.translation for each in truth])
    turn = Rotation.from_matrix((truth[0].place @ room.stations[0].place.inverse()).rotation)
    held = turn.apply(found - found[0]) + centres[0]
    in_sigmas, turns = [], []
    for station, each, at in zip(room.stations[1:], truth[1:], held[1:], strict=True):
        off = turn.inv().apply(at - each.place.translation)
        in_sigmas += (off / station.sigma).tolist()
    points, seen = [], []
    for station, each in zip(room.stations, truth, strict=True):
        own = station.cloud.points.reshape(-1, 3)[each.pixel].astype(np.float64)
        there = np.flatnonzero(np.isfinite(own[:, 2]))[::23]
        points.append(station.to_room(own[there]))
        seen.append(each.place @ each.points[there])
    every, surfaces = np.concatenate(points), np.concatenate(seen)
    best, _ = Rotation.align_vectors(surfaces - surfaces.mean(axis=0), every - every.mean(axis=0))
    shift = surfaces.mean(axis=0) - best.apply(every.mean(axis=0))
    places = best.apply(found) + shift - centres
    to_truth = Pose(best.as_matrix(), shift)
    for station, true_station in zip(room.stations, truth, strict=True):
        turns.append(float(np.degrees((to_truth @ station.place @ true_station.place.inverse()).angle)))
    apart = np.linalg.norm(best.apply(every) + shift - surfaces, axis=1)
    cloud = best.apply(blended(room).points.astype(np.float64)) + shift
    of_cloud = from_surfaces(cloud, [seen_by(each, room.calibration.camera.size) for each in truth])
    diagonal = float(np.linalg.norm(truth[0].scene.room.edges.sum(axis=0)))
    far = np.linalg.norm(places, axis=1)
    return Row(
        len(room.stations),
        len(true),
        int(np.count_nonzero(far > 0.02)),
        1000 * float(far.max()),
        max(turns),
        100 * np.percentile(of_cloud, (50, 95)) / diagonal,
        100 * np.percentile(apart, (50, 95)) / diagonal,
        1000 * balls_off(room, truth),
        in_sigmas,
        list(lengths_in_sigmas(room, truth, best, shift)),
        100 * abs(room.calibration.camera.focal_px[0] / truth[0].calibration.camera.focal_px[0] - 1),
        [f"{outlier.name}: {outlier.finding.kind.name}" for outlier in room.outlier_stations],
        start_s,
        solve_s,
    )


def seen_by(station: TrueStation, camera: Size) -> Floats:
    """True points (H, W, 3) of the camera's pixels in the simulation's frame; NaN where unlit."""
    world = np.full((camera.height * camera.width, 3), np.nan)
    world[station.pixel] = station.place @ station.points
    return world.reshape(camera.height, camera.width, 3)


def balls_off(room: SolvedRoom, truth: Sequence[TrueStation]) -> float:
    """Error of the distance between the two balls in metres; NaN if one was not seen."""
    seen = list(zip(room.stations, truth, strict=True))
    balls = [
        [station.cloud.points.reshape(-1, 3)[each.pixel[each.surface == number]] for station, each in seen]
        for number in truth[0].scene.spheres
    ]
    return centres_apart(room.stations, balls, _RADIUS_M) - _BALLS_M


def lengths_in_sigmas(room: SolvedRoom, truth: Sequence[TrueStation], turn: Rotation, shift: Floats) -> list[float]:
    """Errors over sigmas of the angles between the plan's walls, compared with the walls of the scene."""
    scene = truth[0].scene
    normals = scene.normals(
        np.arange(6 + 6 * len(scene.blocks), dtype=np.int32), np.zeros((3, 6 + 6 * len(scene.blocks)))
    ).T
    found = []
    for corner in floor_plan(room).corners:
        true = []
        for plane in corner.planes:
            there = turn.apply(room.planes[plane].normal)
            near = normals @ there
            offset = np.array([n @ scene.points_on(k, np.zeros((2, 1)))[:, 0] for k, n in enumerate(normals)])
            mine = room.planes[plane].offset + there @ shift
            match = np.flatnonzero((near > np.cos(np.radians(1.0))) & (np.abs(offset - mine) < 0.03))
            true.append(normals[match[0]] if len(match) else None)
        if true[0] is not None and true[1] is not None:
            angle = 180 - np.degrees(np.arccos(true[0] @ true[1]))
            found.append(float((corner.angle_deg.value - angle) / corner.angle_deg.sigma))
    return found


def rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=6)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--stations", type=int, default=6)
    parser.add_argument("--camera", type=int, nargs=2, default=(612, 512))
    parser.add_argument("--without", type=int)
    parser.add_argument("--changed", type=int)
    parser.add_argument("--pictures", action="store_true")
    args = parser.parse_args()
    camera, rows = Size(*args.camera), []
    print("of surfaces: % of the diagonal, median and 95 %")
    print(
        "room  joined  wrong  place mm   turn °     cloud            pixels      balls mm  focal %   start s  solve s"
    )
    for seed in range(args.first, args.first + args.rooms):
        try:
            how = {"furniture_askew_deg": 4.0, "ball_bar_m": _BALLS_M}
            true = stations(args.stations, seed, camera=args.camera, pictures=args.pictures, **how)
        except DeviceError:
            continue
        if args.changed is not None:
            true[args.changed] = with_turned_projector(true[args.changed], any_turn([seed, args.changed]))
        kept = [k for k in np.random.default_rng(seed).permutation(len(true)) if k != args.without]
        try:
            row = measure([true[k] for k in kept], camera)
        except RefusalError as refusal:
            print(f"{seed:4d}  refused: {refusal.reason}")
            continue
        rows.append(row)
        print(
            f"{seed:4d}{row.joined:5d}/{row.stations}{row.wrong:7d}{row.place_mm:10.2f}{row.turn_deg:9.4f}"
            f"{row.cloud_percent[0]:9.4f}{row.cloud_percent[1]:9.4f}{row.pixels_percent[0]:11.4f}"
            f"{row.pixels_percent[1]:9.4f}{row.balls_mm:10.2f}{row.focal_percent:9.4f}"
            f"{row.start_s:10.1f}{row.solve_s:9.1f}  {', '.join(row.outlier_stations)}",
            flush=True,
        )
    print(f"error/sigma of places, rms: {rms([x for row in rows for x in row.in_sigmas]):.2f}")
    angles = [x for row in rows for x in row.lengths_in_sigmas]
    print(
        f"error/sigma of angles between walls, rms: {rms(angles):.2f} ({len(angles)}, of which a room's hang together)"
    )
    print(f"peak memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")


if __name__ == "__main__":
    main()
