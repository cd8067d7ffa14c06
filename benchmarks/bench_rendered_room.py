"""Whole rooms rendered by other software (`rendered_room.py`), from frames to poses, surfaces and balls.

    python benchmarks/bench_rendered_room.py ROOM... [--calibrated] [--seed 0] [--without 2]

ROOM is a folder of `rendered_room.py`. Stations are decoded and in random order; only image sizes and baseline of the
rig are known. `--calibrated`: the true calibration is given and fixed. Poses are compared in the best overall frame.
Surface errors are relative to the room's diagonal, median and 95 %: of the room's cloud from the nearest true surface,
and of the stations' clouds, pixel by pixel, from the true points. Errors over sigmas are rms; those of lengths include
distances between facing planes, and angles. 'light' is the distance of matches from the true projector pixels, median
and 95 %.
"""

import argparse
import resource
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from room_truth import centres_apart, from_surfaces
from scipy.spatial.transform import Rotation

from calib.geometry import Calibration, Intrinsics, Pose
from calib.numerics import Floats
from calib.refusal import RefusalError
from calib.rooms import angle_deg, centre_of, gap
from scanner.configuration import Config
from scanner.results import Decoded
from scanner.rooms import SolvedRoom, blended, rig_from_stations, solve_room
from scanner.stations import RigStart, read_stations
from scanner.ui import Terminal

_BALLS_M, _RADIUS_M = 3.0, 0.12
_ON_BALL_M = 2e-4
_SAMPLE = 11
_WRONG_M = 0.02
_FACING, _CROSSING = -0.98, 0.1  # of two normals' product
_ROUNDS, _EXACT = 8, 1e-5  # baselines


@dataclass(frozen=True, eq=False)
class Truth:
    """`points` (S, H, W, 3): of the camera pixels, in each station's camera frame; lengths in metres."""

    rig: Calibration
    places: tuple[Pose, ...]
    points: Floats
    balls: Floats
    diagonal: float

    @classmethod
    def read(cls, room: Path) -> "Truth":
        stored = np.load(room / "truth.npz")
        camera, projector = (_device(stored[name]) for name in ("camera", "projector"))
        rig = Calibration(camera, projector, Pose(stored["rotation"], stored["translation"]), "m")
        places = tuple(Pose(r, t) for r, t in zip(stored["rotations"], stored["translations"], strict=True))
        return cls(rig, places, stored["points"], stored["balls"], float(stored["diagonal"]))

    def in_world(self, station: int) -> Floats:
        """Points (H, W, 3) of a station in the world."""
        place = self.places[station]
        world: Floats = place @ self.points[station].astype(np.float64)
        return world


def _device(stored: Floats) -> Intrinsics:
    width, height, focal, x, y, *lens = stored.tolist()
    k1, k2, p1, p2, k3 = lens
    return Intrinsics(int(width), int(height), (focal, focal), (x, y), (k1, k2, p1, p2, k3))


def config_of(truth: Truth) -> Config:
    camera, projector = truth.rig.camera, truth.rig.projector
    return Config.model_validate(
        {
            "camera": {
                "width": camera.width,
                "height": camera.height,
                "principal_point": {"prior": "centre", "sigma_px": 0.055 * camera.width},
            },
            "projector": {"width": projector.width, "height": projector.height},
            "scale": {"baseline_m": truth.rig.baseline},
        }
    )


def light_errors(captures: Sequence[Decoded], order: Sequence[int], truth: Truth) -> Floats:
    """Errors of all matches, in projector pixels, (N,)."""
    errors = []
    for capture, station in zip(captures, order, strict=True):
        pixels = np.rint(capture.matches.camera_px).astype(int)
        points = truth.points[station][pixels[:, 1], pixels[:, 0]].astype(np.float64)
        expected = truth.rig.projector.project(truth.rig.pose @ points)
        errors.append(np.linalg.norm(capture.matches.projector_px - expected, axis=1))
    return np.concatenate(errors)


def overlaps(captures: Sequence[Decoded], order: Sequence[int], truth: Truth) -> Floats:
    """Share of the points of each station that the next one in the ring measured, too, (S,)."""
    lit = {}
    for capture, station in zip(captures, order, strict=True):
        mask = np.zeros(truth.points.shape[1:3], np.bool_)
        pixels = np.rint(capture.matches.camera_px).astype(int)
        mask[pixels[:, 1], pixels[:, 0]] = True
        lit[station] = mask
    found = []
    for station in sorted(lit):
        other = (station + 1) % len(truth.places)
        if other not in lit:
            continue
        place = truth.places[other]
        world = truth.in_world(station)[lit[station]][::17]
        there = place.undo(world)
        ahead = there[:, 2] > 0.1
        pixels = np.rint(truth.rig.camera.project(there[ahead]))
        size = truth.rig.camera.size
        inside = np.all((pixels >= 0) & (pixels < [size.width, size.height]), axis=1)
        at = pixels[inside].astype(int)
        depth = truth.points[other][at[:, 1], at[:, 0], 2]
        seen = (np.abs(depth - there[ahead][inside, 2]) < 0.03) & lit[other][at[:, 1], at[:, 0]]
        found.append(np.count_nonzero(seen) / len(world))
    return np.array(found)


def report(room: SolvedRoom, order: Sequence[int], truth: Truth) -> None:
    members = [order[k] for k in room.group.stations]
    points, seen = [], []
    for station, k in zip(room.stations, members, strict=True):
        own = station.cloud.points.reshape(-1, 3).astype(np.float64)
        there = np.flatnonzero(np.isfinite(own[:, 2]))[::_SAMPLE]
        points.append(station.to_room(own[there]))
        seen.append(truth.in_world(k).reshape(-1, 3)[there])
    every, surfaces = np.concatenate(points), np.concatenate(seen)
    turn, _ = Rotation.align_vectors(surfaces - surfaces.mean(axis=0), every - every.mean(axis=0))
    shift = surfaces.mean(axis=0) - turn.apply(every.mean(axis=0))
    apart = np.linalg.norm(turn.apply(every) + shift - surfaces, axis=1) / truth.diagonal
    cloud = turn.apply(blended(room).points.astype(np.float64)) + shift
    off_surface = from_surfaces(cloud, [truth.in_world(k) for k in range(len(truth.places))]) / truth.diagonal
    found = np.array([station.place.translation for station in room.stations])
    off = turn.apply(found) + shift - [truth.places[k].translation for k in members]
    turned = [
        np.degrees((Pose(turn.as_matrix(), shift) @ station.place @ truth.places[k].inverse()).angle)
        for station, k in zip(room.stations, members, strict=True)
    ]
    far = np.linalg.norm(off, axis=1)
    camera, rig = room.calibration.camera, truth.rig
    print(f"  joined {len(room.stations)} of {len(order)}, wrong {np.count_nonzero(far > _WRONG_M)}")
    print(f"  places mm {np.round(1000 * far, 2)}  turns ° {np.round(turned, 4)}")
    for name, errors in (("cloud", off_surface), ("pixels", apart)):
        print(
            f"  surfaces, {name}: {100 * np.median(errors):.4f} % median, {100 * np.percentile(errors, 95):.4f} % 95 %"
        )
    print(f"  balls {1000 * (balls_apart(room, members, truth) - _BALLS_M):+.2f} mm")
    print(f"  error/sigma: {in_sigmas(room, members, truth)}, {lengths_in_sigmas(room, members, truth)}")
    print(f"  focal {100 * (camera.focal_px[0] / rig.camera.focal_px[0] - 1):+.4f} %, lens {_lens(camera)}")
    print(f"  noise {[round(float(s.residual_px), 4) for s in room.stations]}, alike {room.estimate.levels.alike:.2f}")


def _lens(device: Intrinsics) -> str:
    return " ".join(f"{term:.5f}" for term in device.distortion)


def balls_apart(room: SolvedRoom, members: Sequence[int], truth: Truth) -> float:
    """Distance of the fitted centres, in metres; NaN if a ball has too few points."""
    seen = [(station.cloud.points, truth.in_world(k)) for station, k in zip(room.stations, members, strict=True)]
    balls = [
        [points[np.abs(np.linalg.norm(world - ball, axis=2) - _RADIUS_M) < _ON_BALL_M] for points, world in seen]
        for ball in truth.balls
    ]
    return centres_apart(room.stations, balls, _RADIUS_M)


def in_sigmas(room: SolvedRoom, members: Sequence[int], truth: Truth) -> str:
    """Errors over sigmas of poses relative to the first station, rms."""
    first, true = room.stations[0].place, truth.places[members[0]]
    to_room = first @ true.inverse()
    moved, turned = [], []
    for station, k in zip(room.stations[1:], members[1:], strict=True):
        step = (to_room @ truth.places[k]).local(station.place)
        moved += (step[3:] / station.sigma).tolist()
        turned += (np.degrees(step[:3]) / station.sigma_deg).tolist()
    return f"places {_rms(moved):.2f}, turns {_rms(turned):.2f}"


def lengths_in_sigmas(room: SolvedRoom, members: Sequence[int], truth: Truth) -> str:
    """Errors over sigmas of distances of facing planes, and of angles of crossing ones, rms."""
    true = true_planes(room, members, truth)
    gaps, angles = [], []
    for a, b in combinations(true, 2):
        product = float(true[a][0] @ true[b][0])
        if product < _FACING:
            found = gap(room.estimate, a, b)
            middle = (centre_of(room.estimate, a) + centre_of(room.estimate, b)) / 2
            foot = middle - (true[a][0] @ middle - true[a][1]) * true[a][0]
            gaps.append((found.value - abs(float(true[b][0] @ foot - true[b][1]))) / found.sigma)
        elif abs(product) < _CROSSING:
            found = angle_deg(room.estimate, a, b)
            angles.append((found.value - (180 - float(np.degrees(np.arccos(product))))) / found.sigma)
    return f"distances {_rms(gaps):.2f} ({len(gaps)}), angles {_rms(angles):.2f} ({len(angles)})"


def true_planes(room: SolvedRoom, members: Sequence[int], truth: Truth) -> dict[int, tuple[Floats, float]]:
    """True planes in the estimate's frame and baselines, by number: normals and offsets of the true points of pixels on
    the planes.
    """
    first, on = truth.places[members[0]], dict[int, list[Floats]]()
    for station, k in zip(room.stations, members, strict=True):
        for plane in np.unique(station.plane[station.plane >= 0]):
            points = first.undo(truth.in_world(k)[station.plane == plane])
            on.setdefault(int(plane), []).append(points / truth.rig.baseline)
    found = {}
    for plane, parts in on.items():
        points = np.concatenate(parts)
        for _ in range(_ROUNDS):
            middle = points.mean(axis=0)
            normal = np.linalg.svd((points - middle)[:: max(1, len(points) // 5000)], full_matrices=False)[2][2]
            away = np.abs((points - middle) @ normal)
            points = points[away <= max(np.median(away) * 3, _EXACT)]
        normal = normal * np.sign(normal @ room.estimate.room.planes[plane].normal)
        if np.median(np.abs((points - points.mean(axis=0)) @ normal)) < _EXACT:
            found[plane] = normal, float(normal @ points.mean(axis=0))
    return found


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rooms", type=Path, nargs="+")
    parser.add_argument("--calibrated", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--without", type=int)
    args = parser.parse_args()
    for folder in args.rooms:
        truth, quiet = Truth.read(folder), Terminal(quiet=True)
        config = config_of(truth)
        shuffled = np.random.default_rng(args.seed).permutation(len(truth.places))
        order = [int(k) for k in shuffled if k != args.without]
        captures = read_stations([folder / str(k + 1) for k in order], config, quiet)
        light = light_errors(captures, order, truth)
        print(f"{folder}: light {np.median(light):.4f} px median, {np.percentile(light, 95):.3f} px 95 %")
        print(f"  neighbours overlap by {np.round(100 * overlaps(captures, order, truth))} %", flush=True)
        began = time.process_time()
        try:
            start = _given(truth) if args.calibrated else rig_from_stations(captures, config, quiet)
            started = time.process_time()
            room = solve_room(captures, start, config, quiet)
        except RefusalError as refusal:
            print(f"  refused: {refusal.reason}")
            continue
        ended = time.process_time()
        for outlier in room.outlier_stations:
            print(f"  {outlier.name}: {outlier.finding.message}")
        report(room, order, truth)
        print(f"  seconds of one processor: corners {started - began:.1f}, rest {ended - started:.1f}", flush=True)
    print(f"peak memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")


def _given(truth: Truth) -> RigStart:
    length = truth.rig.baseline
    rig = Calibration(
        truth.rig.camera,
        truth.rig.projector,
        Pose(truth.rig.pose.rotation, truth.rig.pose.translation / length),
        "baseline",
    )
    return RigStart(rig, None, {}, truth.rig)


if __name__ == "__main__":
    main()
