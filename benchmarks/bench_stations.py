"""Cost of more stations: 6, 12 and 24 of one room, registered without an initial guess and estimated jointly.

    python benchmarks/bench_stations.py [--stations 6 12 24] [--matches 20000] [--seed 1]

Synthetic furnished rooms as of `bench_registration.py` (clouds, for the registration) and of `bench_room_estimate.py`
(matches, for the estimate). Every number of stations runs in its own process, to measure memory. Seconds are
of one processor, from the stations' clouds and from their matches. 'a pair' is per pair of stations that overlap:
share surfaces, as registered, or planes.
"""

import argparse
import resource
import subprocess
import sys
import time
from itertools import combinations
from pathlib import Path

import numpy as np
from bench_registration import view_of

from calib.registration import register
from calib.rooms import RigPrior, RoomEstimate, estimate_room
from calib.synthetic import RoomOptions, random_furnished_room, random_room, ring, seen_from

sys.path.append(str(Path(__file__).parents[1]))
from tests.support.known_rigs import cells_of, disturbed, knowledge_of, true_room


def registered(number: int, seed: int) -> tuple[float, int, int]:
    """Seconds, the number of registered stations, and pairs of them that overlap."""
    rng = np.random.default_rng(seed)
    room = random_furnished_room(rng)
    views = [view_of(seen_from(room, place, rng)) for place in ring(rng, room, number)]
    register(views[:2])  # compile, or load from the cache, before timing
    began = time.process_time()
    found = register(views)
    return time.process_time() - began, len(found.groups[0].stations), len(found.pairs)


def estimated(number: int, matches: int, seed: int) -> tuple[float, int, int]:
    """Seconds, the estimate's columns, and pairs of stations that share a plane."""
    made = random_room(np.random.default_rng(seed), RoomOptions(count=matches), stations=number)
    truth, numbers = true_room(made)
    start = disturbed(np.random.default_rng(seed), truth, made)
    began = time.process_time()
    cells, plane_of = cells_of(made, numbers)
    prior = RigPrior.from_knowledge(knowledge_of(made), start.rig)
    found = estimate_room(cells, plane_of, start.places, start.planes, start.rig, prior)
    return time.process_time() - began, found.room.size, _sharing(found)


def _sharing(found: RoomEstimate) -> int:
    return len({pair for stations in found.stations_of for pair in combinations(stations, 2)})


def memory_gb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def measure(number: int, matches: int, seed: int) -> None:
    seconds, together, pairs = registered(number, seed)
    registration = f"{together:5d}{pairs:7d}{seconds:9.1f} s{seconds / max(pairs, 1):8.2f} s"
    seconds, columns, pairs = estimated(number, matches, seed)
    estimate = f"{columns:8d}{pairs:7d}{seconds:9.1f} s{seconds / max(pairs, 1):8.2f} s"
    print(f"{number:8d}{registration}   {estimate}{memory_gb():9.2f} GB", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stations", type=int, nargs="+", default=(6, 12, 24))
    parser.add_argument("--matches", type=int, default=20_000, help="of a station, for the estimate")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    if len(args.stations) == 1:
        measure(args.stations[0], args.matches, args.seed)
        return
    print("stations  registered: pairs, all, a pair     estimated: columns, pairs, all, a pair    memory", flush=True)
    for number in args.stations:
        same = ["--matches", str(args.matches), "--seed", str(args.seed)]
        subprocess.run([sys.executable, __file__, "--stations", str(number), *same], check=True)


if __name__ == "__main__":
    main()
