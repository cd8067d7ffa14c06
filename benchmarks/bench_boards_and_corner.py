"""Boards and a corner of one rig: the gain of calibrating jointly, and error over sigma.

python benchmarks/bench_boards_and_corner.py [--rigs 30]

Synthetic rigs with ground truth: five boards (corners of 0.08 px, matches of 0.1 px) and one capture of a corner
(20,000 matches of 0.1 px, walls off by 0.3°). Also the
smallest zoom of the projector in between that is detected.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.geometry import Calibration
from calib.numerics import Floats
from calib.refusal import RefusalError

sys.path.append(str(Path(__file__).parents[1]))
from tests.support.known_rigs import Before, corner_before, from_boards

_NAMES = ("f_c", "x_c", "y_c", "f_p", "x_p", "y_p", "baseline")
_ZOOMS = (1.0005, 1.001, 1.002)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=30)
    count = parser.parse_args().rigs
    by_boards, by_both, shares, refused = [], [], [], 0
    found_out = dict.fromkeys(_ZOOMS, 0)
    for seed in range(count):
        rng = np.random.default_rng(1000 + seed)
        rig, boards, known = from_boards(rng, views=5, matches=3000)
        before = Before(rig, boards, known, corner_before(rng, rig, 1.0))
        try:
            joint = before.joint().metric
        except RefusalError as refusal:
            print(f"rig {seed}: {refusal.reason}")
            refused += 1
            continue
        by_boards.append((_numbers(known.calibration) - _numbers(rig)) / _sigmas(known.calibration))
        by_both.append((_numbers(joint) - _numbers(rig)) / _sigmas(joint))
        shares.append(_sigmas(joint) / _sigmas(known.calibration))
        for zoom in _ZOOMS:
            found_out[zoom] += _is_refused(replace(before, corner=corner_before(rng, rig, zoom)))
    print(f"{len(shares)} of {count} rigs, {refused} refused\n{'':34}" + "".join(f"{name:>10}" for name in _NAMES))
    for what, rows in (("boards: error / sigma, rms", by_boards), ("together: error / sigma, rms", by_both)):
        print(f"{what:34}" + "".join(f"{value:10.2f}" for value in np.sqrt(np.mean(np.square(rows), axis=0))))
    for what, values in (("sigma together / by boards, median", np.median), ("the same, least", np.min)):
        print(f"{what:34}" + "".join(f"{value:10.2f}" for value in values(shares, axis=0)))
    for zoom, times in found_out.items():
        print(f"projector zoomed by {100 * (zoom - 1):.2f} % in between: found {times} of {len(shares)} times")


def _is_refused(before: Before) -> bool:
    try:
        before.joint()
    except RefusalError:
        return True
    return False


def _numbers(rig: Calibration) -> Floats:
    devices = (rig.camera, rig.projector)
    return np.array([*(x for d in devices for x in (d.focal_px[0], *d.principal_point_px)), rig.baseline])


def _sigmas(rig: Calibration) -> Floats:
    devices = (rig.sigma.camera, rig.sigma.projector)
    stated = [x for d in devices for x in ((d.focal_px or (np.nan,))[0], *(d.principal_point_px or (np.nan, np.nan)))]
    return np.array([*stated, rig.sigma.known_baseline])


if __name__ == "__main__":
    main()
