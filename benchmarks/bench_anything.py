"""Calibrations without a corner or a board, compared with the truth: nothing is known but what stations share.

    python benchmarks/bench_anything.py [--how turned] [--things 10] [--first 0] [--stations 6] [--gloss 0] \
        [--drift 0] [--kind lump] [--texture print]

Simulated things of 100 mm before a resting rig, with matches from rays and 0.05 projector px of noise; `--drift`: the
projector's picture is elsewhere at each station, by that many pixels in both directions. `--how`:

- `turned`: by 12 to 25° about random axes,
- `turntable`: by steps of 15°, and tipped by 30° at one more,
- `cluttered`: a rig at places about a clutter of two dozen bodies, turned by 12 to 25° about random axes,
- `one-axis`: by steps of 15°, which determines no calibration and has to be refused.

`--texture none`: things of plain plaster, whose pictures show their shading; `blank`: pictures that show nothing, so
that only shapes are left. `--kind ball` and others: another shape, which may determine nothing and has to be refused.

Seconds are of processor time.
"""

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calib.numerics import Floats
from calib.refusal import RefusalError
from scanner.objects import rig_from_object
from scanner.ui import Terminal

sys.path.append(str(Path(__file__).parents[1]))
from tests.support.things import (
    ThingStation,
    cluttered_stations,
    config_for,
    decoded,
    thing_stations,
    true_rig,
    turned_stations,
)

_CAMERA = (612, 512)
_GREY = 128  # of a picture that shows nothing
_TIPPED = 5  # a step at which the simulated turntable tips


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--things", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--stations", type=int, default=6)
    parser.add_argument("--how", choices=["turned", "turntable", "cluttered", "one-axis"], default="turned")
    parser.add_argument("--gloss", type=float, default=0.0)
    parser.add_argument("--drift", type=float, default=0.0)
    parser.add_argument("--kind", choices=["lump", "ball", "vase", "plate", "box"], default="lump")
    parser.add_argument("--texture", choices=["print", "none", "blank"], default="print")
    args = parser.parse_args()
    thing: dict[str, Any] = {"gloss": args.gloss, "kind": args.kind}
    if args.texture != "print":
        thing["patches"] = 0.0
    print("thing  stations  points  f_c %   f_p %    sigma       x_c, y_c px    x_p, y_p px    error/sigma  seconds")
    ratios: list[Floats] = []
    focals: list[float] = []
    for seed in range(args.first, args.first + args.things):
        stations = _drifted(_stations(args.how, args.stations, seed, thing), args.drift, seed)
        if args.texture == "blank":
            stations = [replace(station, picture=np.full_like(station.picture, _GREY)) for station in stations]
        began = time.process_time()
        try:
            start = rig_from_object(
                decoded(stations, _CAMERA, pictures=True), config_for(_CAMERA), Terminal(quiet=True)
            )
        except RefusalError as refusal:
            print(f"{seed:5d}  refused: {refusal.reason}")
            continue
        seconds = time.process_time() - began
        uncertainty, finding = start.uncertainty, start.findings[0]
        assert uncertainty is not None
        error = uncertainty.rig.step_to(true_rig(stations[0].calibration))
        sigma = np.sqrt(np.diag(uncertainty.covariance))
        ratios.append(error / sigma)
        focals += np.abs(error[[0, 8]]).tolist()
        focal, spread, (x_c, y_c, x_p, y_p) = 100 * error[[0, 8]], 100 * sigma[[0, 8]], error[[1, 2, 9, 10]]
        print(
            f"{seed:5d}  {finding.data['captures']:8.0f}  {finding.data['points']:6.0f}  "
            f"{focal[0]:+.3f}  {focal[1]:+.3f}  {spread[0]:.3f}, {spread[1]:.3f}  "
            f"{x_c:+6.2f}, {y_c:+6.2f}  {x_p:+6.2f}, {y_p:+6.2f}  "
            f"{np.sqrt(np.mean(ratios[-1] ** 2)):11.2f}  {seconds:7.1f}",
            flush=True,
        )
    if ratios:
        print(
            f"error of a focal length: {100 * np.median(focals):.3f} % in the median, {100 * max(focals):.3f} % at most"
        )
        print(f"error/sigma, rms over all columns: {np.sqrt(np.mean(np.square(ratios))):.2f}")


def _stations(how: str, count: int, seed: int, thing: Mapping[str, Any]) -> list[ThingStation]:
    if how == "turned":
        return turned_stations(count, _CAMERA, seed, **thing)
    if how == "cluttered":
        return cluttered_stations(count, _CAMERA, seed, **thing)
    steps = thing_stations([*range(count)], _CAMERA, seed, steps=24, **thing)
    if how == "one-axis":
        return steps
    return [*steps, *thing_stations([_TIPPED], _CAMERA, seed, steps=24, tip_deg=30.0, **thing)]


def _drifted(stations: Sequence[ThingStation], drift_px: float, seed: int) -> list[ThingStation]:
    rng = np.random.default_rng([seed, 21])
    return [
        replace(station, matches=replace(station.matches, projector_px=station.matches.projector_px + shift))
        for station, shift in zip(stations, drift_px * rng.standard_normal((len(stations), 2)), strict=True)
    ]


if __name__ == "__main__":
    main()
