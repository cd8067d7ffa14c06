"""Time of a calibration, by the number of matches.

    OPENBLAS_NUM_THREADS=1 python benchmarks/bench_speed.py

'Gram': accumulating the normal matrices that the paper's search needs; 'search': that search. 'cells': averaging the
matches for the refinement; 'refined': the whole refinement from the matches, with covariance. Medians of several runs.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np

from calib.closed_form import objective_for, search
from calib.estimation import into_cells
from calib.geometry import Matches
from calib.self_calibration import PrincipalPoint, paper_trials, self_calibrate
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, random_capture

CAMERA_SIZE = (PAPER_CAMERA.width, PAPER_CAMERA.height)
PROJECTOR_SIZE = (PAPER_PROJECTOR.width, PAPER_PROJECTOR.height)
KNOWN = PrincipalPoint(PAPER_CAMERA.principal_point_px, 0.0)


def seconds(run: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--matches", type=int, nargs="+", default=[10_000, 100_000, 1_000_000, 10_000_000])
    options = parser.parse_args()
    print(f"{'matches':>10} {'Gram':>9} {'search':>9} {'cells':>9} {'refined':>9}")
    for count in options.matches:
        capture = random_capture(np.random.default_rng(options.seed), count=count)
        matches = capture.matches
        objective = objective_for(matches, KNOWN.px)

        def refined(matches: Matches = matches) -> object:
            return self_calibrate(matches, CAMERA_SIZE, PROJECTOR_SIZE, principal_point=KNOWN, squareness_deg=0.0)

        runs = (
            lambda matches=matches: objective_for(matches, KNOWN.px),
            lambda objective=objective: search(objective, paper_trials(CAMERA_SIZE)),
            lambda matches=matches: into_cells(matches),
            refined,
        )
        times = "".join(f"{seconds(run, options.repeats):8.3f} s" for run in runs)
        print(f"{len(matches):10d}{times}", flush=True)


if __name__ == "__main__":
    main()
