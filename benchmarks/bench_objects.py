"""Things on a turntable or placed by hand, joined without an initial guess, compared with the truth.

    python benchmarks/bench_objects.py [--things 4] [--first 0] [--steps 12] [--free] [--camera 408 342] [--noise 0.05]
    python benchmarks/bench_objects.py --balls 3

Simulated things of 100 mm (superquadrics with added waves) in front of a table and a wall. Matches come from rays, one
per camera pixel, with noise in projector px; stations are in random order. The calibration is the true one and adds
nothing to errors and sigmas. Errors are the largest of a thing's stations: rotation, and shift of the thing's middle,
both relative to the first station; and the median distance of the mesh's vertices from the true surface, with the
estimated and with the true poses. Error/sigma of shifts excludes those along a turntable's axis, which are zero by
definition. The volume is that of the closed surface (`--fill`), if less than 20 % of it is bridged. A station is wrong
if it is off by more than 1° without a warning. Seconds are of one processor, without casting rays.

`--balls`: volumes of this many plain balls, placed twelve times by hand. The rotation of a ball is undetermined, so the
true poses are used.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.deferred_imports import open3d
from calib.geometry import Pose, rotation_vector
from calib.numerics import Floats
from calib.refusal import RefusalError
from hw.simulated.things import Solid
from scanner.objects import SolvedObject, cloud_of, solve_object, surface_of, verdict_on
from scanner.rooms import CAMERA_FROM_ROOM
from scanner.stations import RigStart
from scanner.ui import Terminal

sys.path.append(str(Path(__file__).parents[1]))
from tests.support.things import config_for, decoded, thing_stations

_WRONG_DEG = 1.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--things", type=int, default=4)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--steps", type=int, default=12)
    parser.add_argument("--free", action="store_true", help="put down by hand, instead of the turntable")
    parser.add_argument("--camera", type=int, nargs=2, default=(408, 342))
    parser.add_argument("--noise", type=float, default=0.05)
    parser.add_argument("--balls", type=int, default=0)
    args = parser.parse_args()
    camera = (args.camera[0], args.camera[1])
    if args.balls:
        for seed in range(args.first, args.first + args.balls):
            _ball(seed, args.steps, camera, args.noise)
        return
    print(
        "thing  joined  wrong  turn °   shift mm  surface mm  by true places  verdict  s a station  error/sigma  volume"
    )
    ratios: list[Floats] = []
    for seed in range(args.first, args.first + args.things):
        order = np.random.default_rng(seed).permutation(args.steps).tolist()
        stations = thing_stations(order, camera, seed, args.noise, steps=args.steps, turntable=not args.free)
        rig, began = stations[0].calibration, time.process_time()
        start = RigStart(rig.in_baselines, None, {}, rig)
        try:
            found = solve_object(decoded(stations, camera, True), start, config_for(camera), Terminal(quiet=True))
        except RefusalError as refusal:
            print(f"{seed:5d}  refused: {refusal.reason}")
            continue
        seconds = (time.process_time() - began) / args.steps
        places = [stations[station.number].place for station in found.stations]
        errors, relative = _errors(found, places)
        grade = verdict_on(found).grade
        ratios += [relative] if grade != "refused" else []
        turns, shifts = _over_sigma(relative)
        wrong = 0 if grade == "refused" else int(np.count_nonzero(errors[:, 0] > _WRONG_DEG))
        surfaces = [_from_surface(each, stations[0].solid, places[0]) for each in (found, _with_true(found, places))]
        print(
            f"{seed:5d}  {len(places):3d}/{args.steps:<2d}  {wrong:5d}  {errors[:, 0].max():7.4f}  "
            f"{1e3 * errors[:, 1].max():8.4f}  {1e3 * surfaces[0]:10.4f}  {1e3 * surfaces[1]:14.4f}  "
            f"{grade:>7s}  {seconds:11.1f}  {turns:.2f}, {shifts:.2f}   {_volume(found, stations[0].solid)}",
            flush=True,
        )
    if ratios:
        turns, shifts = _over_sigma(np.concatenate(ratios))
        print(f"error/sigma, rms: rotations {turns:.2f}, shifts {shifts:.2f}")


def _ball(seed: int, steps: int, camera: tuple[int, int], noise: float) -> None:
    stations = thing_stations([*range(steps)], camera, seed, noise, turntable=False, kind="ball", background=False)
    rig = stations[0].calibration
    start = RigStart(rig.in_baselines, None, {}, rig)
    found = solve_object(decoded(stations, camera, True), start, config_for(camera), Terminal(quiet=True))
    places = [stations[station.number].place for station in found.stations]
    print(f"ball {seed}: {len(places)} stations, volume {_volume(_with_true(found, places), stations[0].solid)}")


def _volume(found: SolvedObject, solid: Solid) -> str:
    """Relative error of the closed surface's volume, and its relative sigma."""
    surface = surface_of(found, cloud_of(found), fill=True)
    if surface is None or surface.volume is None:
        return "–"
    volume, sigma = surface.volume
    return f"{100 * (volume / solid.volume - 1):+.3f} ± {100 * sigma / solid.volume:.3f} %"


def _over_sigma(relative: Floats) -> tuple[float, float]:
    """Root mean squares of errors over sigmas (n, 6), of rotations and of shifts."""
    turns, shifts = (float(np.sqrt(np.nanmean(part**2))) for part in (relative[:, :3], relative[:, 3:]))
    return turns, shifts


def _errors(found: SolvedObject, places: list[Pose]) -> tuple[Floats, Floats]:
    """Rotation in degrees and shift of the middle (n, 2), and both over their sigmas (n, 6), of all stations but the
    first.
    """
    first = found.stations[0].place
    # In the frame of the truth, the first station has its estimated pose.
    moved = first @ places[0].inverse()
    errors, relative = [], []
    for station, place in zip(found.stations[1:], places[1:], strict=True):
        off = station.place @ (moved @ place).inverse()
        turn = rotation_vector(off.rotation)
        # The thing's middle is the origin, or beside it on the axis.
        errors.append([np.degrees(np.linalg.norm(turn)), np.linalg.norm(off.translation)])
        relative.append(np.concatenate([np.degrees(turn) / station.sigma_deg, off.translation / station.sigma]))
    if found.turntable is not None:
        # The middle is on the axis, the z axis of the frame; shifts along it are zero, also by their sigmas.
        relative = [np.append(each[:5], np.nan) for each in relative]
    return np.array(errors), np.array(relative)


def _with_true(found: SolvedObject, places: list[Pose]) -> SolvedObject:
    moved = found.stations[0].place @ places[0].inverse()
    pairs = zip(found.stations, places, strict=True)
    return replace(found, stations=tuple(replace(each, place=moved @ place) for each, place in pairs))


def _from_surface(found: SolvedObject, solid: Solid, first: Pose) -> float:
    """Median distance of the mesh's vertices from the true surface; NaN without a mesh."""
    surface = surface_of(found, cloud_of(found), fill=False)
    if surface is None:
        return np.nan
    o3d = open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(solid.vertices.astype(np.float32)), o3d.core.Tensor(solid.triangles.astype(np.uint32))
    )
    into = first @ found.stations[0].place.inverse()
    points = into @ (surface.mesh.points @ CAMERA_FROM_ROOM)
    return float(np.median(scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy()))


if __name__ == "__main__":
    main()
