"""Registration of stations of synthetic rooms without an initial guess, compared with the truth.

    python benchmarks/bench_registration.py --seeds 0 20 --kinds whole open stranger two moved bare [--painted]

Furnished rooms with walls off square by 0.3°, six stations in random order of which neighbours overlap by 30 to 50 %,
clouds with 3 mm of noise at 3 m and bent by 0.3 % of a wrong calibration. `open`: one station is missing; `stranger`:
one more is of another room; `two`: four stations of one room and three of another; `moved`: one station's rig was
changed; `bare`: no furniture. `--painted`: stations have pictures, of surfaces with a poster here and
there. 'wrong': stations whose pose relative to the first of their group is off (1°, 80 mm), or in a group
with another room's. 'left out': of those that belong. Seconds are of one processor.
"""

import argparse
import time
from dataclasses import dataclass, replace

import numpy as np

from calib.geometry import Pose
from calib.pointcloud import surface
from calib.registration import Registration, StationView, find_keypoints, register, station_view
from calib.synthetic import STATION_CAMERA, Paint, StationCloud, moved_rig, random_furnished_room, ring, seen_from

KINDS = ("whole", "open", "stranger", "two", "moved", "bare")
_LIMITS = (1.0, 0.08)  # degrees, metres


@dataclass(frozen=True)
class Stop:
    """A station with its room and rig."""

    station: StationCloud
    room: int


def stops(kind: str, seed: int, painted: bool = False) -> list[Stop]:
    rng = np.random.default_rng(1000 + seed)
    found = seen(seed, 0, painted, 0 if kind == "bare" else 8)
    if kind == "open":
        found.pop(int(rng.integers(len(found))))
    elif kind == "stranger":
        found += seen(500 + seed, 1, painted)[:1]
    elif kind == "two":
        found = found[:4] + seen(500 + seed, 1, painted)[:3]
    elif kind == "moved":
        k = int(rng.integers(len(found)))
        found[k] = Stop(moved_rig(found[k].station), 2)
    return [found[k] for k in rng.permutation(len(found))]


def seen(seed: int, name: int, painted: bool, pieces: int = 8) -> list[Stop]:
    rng = np.random.default_rng(seed)
    room = random_furnished_room(rng, pieces)
    paint = Paint(seed) if painted else None
    return [Stop(seen_from(room, place, rng, paint=paint), name) for place in ring(rng, room, 6)]


def view_of(station: StationCloud) -> StationView:
    normals = surface(station.points, float(np.mean(STATION_CAMERA.focal_px))).normals
    view = station_view(station.points, normals, STATION_CAMERA)
    if station.picture is None:
        return view
    keypoints = find_keypoints(station.picture, view.points, view.labels, view.planes, STATION_CAMERA)
    return replace(view, keypoints=keypoints)


def errors(found: Registration, of: list[Stop]) -> list[tuple[float, float]]:
    """Degrees and metres of each station in a group except the first; infinite for a station of another room."""
    off = []
    for group in found.groups:
        first = of[group.stations[0]]
        for k, place in zip(group.stations[1:], group.places[1:], strict=True):
            if of[k].room != first.room:
                off.append((np.inf, np.inf))
                continue
            true = first.station.place.inverse() @ of[k].station.place
            off.append(apart(true, place))
    return off


def apart(true: Pose, pose: Pose) -> tuple[float, float]:
    error = true.inverse() @ pose
    return float(np.degrees(error.angle)), error.distance


def run(kind: str, seed: int, painted: bool) -> dict[str, float]:
    of = stops(kind, seed, painted)
    views = [view_of(stop.station) for stop in of]
    start = time.process_time()
    found = register(views)
    seconds = time.process_time() - start
    off = errors(found, of)
    wrong = sum(degrees > _LIMITS[0] or metres > _LIMITS[1] for degrees, metres in off)
    own = [left.station for left in found.left_out if [stop.room for stop in of].count(of[left.station].room) > 1]
    right = [each for each in off if np.isfinite(each[0])]
    worst = np.max(right, axis=0) if right else np.zeros(2)
    ambiguous = sum(group.ambiguous for group in found.groups)
    print(
        f"{kind:9} {seed:4}  groups {[group.stations for group in found.groups]} ambiguous {ambiguous} wrong {wrong} "
        f"left out {len(own)}  worst {worst[0]:.2f}° {1000 * worst[1]:.0f} mm  {seconds:.1f} s",
        flush=True,
    )
    for left in found.left_out:
        print(f"{'':15} {left.station}: {left.finding.message}")
    return {"wrong": wrong and not ambiguous, "left out": len(own), "ambiguous": ambiguous, "seconds": seconds}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 20), metavar=("FIRST", "END"))
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--painted", action="store_true")
    args = parser.parse_args()
    for kind in args.kinds:
        rows = [run(kind, seed, args.painted) for seed in range(*args.seeds)]
        total = {name: sum(row[name] for row in rows) for name in rows[0]}
        rooms = sum(row["wrong"] == 0 and row["left out"] == 0 for row in rows)
        print(f"{kind}: {rooms} of {len(rows)} rooms without a fault, {total}\n", flush=True)


if __name__ == "__main__":
    main()
