"""Networks without a corner or a board, compared with the truth: several cameras and projectors before turned things.

    python benchmarks/bench_scene_networks.py [--sizes 2x1 1x2 2x2] [--networks 5] [--first 0] [--stations 4] \
        [--cluttered]

Simulated things of 100 mm, or clutters, turned by 12 to 25° about random axes between stations, before devices with
lenses and places of their own; matches from rays, with 0.05 projector px of noise. 'alone': pairs that are calibrated
by themselves. 'error/sigma': root mean square of focal lengths, principal points, rotations and places over their
sigmas. Seconds are of processor time.
"""

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calib.finding import Finding
from calib.geometry import Intrinsics, Pose, Size
from calib.networks import PLACE, NetworkEstimate
from calib.numerics import Floats
from calib.refinement import PER_DEVICE
from calib.refusal import RefusalError
from scanner.networks import Captures, Pair, calibrate_by_scene
from scanner.ui import SILENT

sys.path.append(str(Path(__file__).parents[1]))
from tests.support.things import PROJECTOR, ThingStation, config_for, decoded, network_stations

_CAMERA = (612, 512)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", nargs="+", default=["2x1", "1x2", "2x2"], metavar="CAMERASxPROJECTORS")
    parser.add_argument("--networks", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--stations", type=int, default=4)
    parser.add_argument("--cluttered", action="store_true")
    args = parser.parse_args()
    print("size  seed  alone  f, worst %   sigma %  x0, y0, worst px  error/sigma  worst  seconds")
    for size in args.sizes:
        cameras, projectors = (int(count) for count in size.split("x"))
        focals, ratios = list[float](), list[float]()
        for seed in range(args.first, args.first + args.networks):
            stations = network_stations(cameras, projectors, args.stations, _CAMERA, seed, is_cluttered=args.cluttered)
            began = time.process_time()
            try:
                estimate, findings = _estimated(stations)
            except RefusalError as refusal:
                print(f"{size:5s} {seed:4d}  refused: {refusal.reason}", flush=True)
                continue
            seconds = time.process_time() - began
            focal, centre_px, relative = errors(estimate, stations[0])
            alone, worst = cameras * projectors + 1 - len(findings), 100 * focal[np.argmax(np.abs(focal))]
            sigma = 100 * max(float(estimate.sigmas(name)[0]) for name in estimate.names)
            focals += np.abs(focal).tolist()
            ratios += relative.tolist()
            print(
                f"{size:5s} {seed:4d}  {alone:5d}  {worst:+10.3f}  "
                f"{sigma:8.3f}  {np.abs(centre_px).max():16.2f}  {np.sqrt(np.mean(relative**2)):11.2f}  "
                f"{np.abs(relative).max():5.1f}  {seconds:7.1f}",
                flush=True,
            )
        if focals:
            print(
                f"{size}: error of a focal length {100 * np.median(focals):.3f} % in the median, "
                f"{100 * max(focals):.3f} % at most; error/sigma {np.sqrt(np.mean(np.square(ratios))):.2f}",
                flush=True,
            )


def _estimated(stations: Sequence[Mapping[Pair, ThingStation]]) -> tuple[NetworkEstimate, tuple[Finding, ...]]:
    config = config_for(_CAMERA)
    by_pair = {pair: decoded([station[pair] for station in stations], _CAMERA, pictures=True) for pair in stations[0]}
    first, *further = ({pair: of_pair[k] for pair, of_pair in by_pair.items()} for k in range(len(stations)))
    sizes = {
        name: size for pair in by_pair for name, size in zip(pair, (Size(*_CAMERA), Size(*PROJECTOR)), strict=True)
    }
    points = {camera: config.principal_point(Size(*_CAMERA)) for camera, _ in by_pair}
    return calibrate_by_scene(Captures(first, sizes, tuple(further)), config, SILENT, lenses={}, points=points)


def errors(estimate: NetworkEstimate, station: Mapping[Pair, ThingStation]) -> tuple[Floats, Floats, Floats]:
    """Relative errors of focal lengths (D,), of principal points (D, 2) in px, and all over their sigmas."""
    poses, devices = _truth(station, estimate.names[0])
    unit = poses[estimate.seed[1]].distance
    focals, centres, relative = list[float](), list[Floats](), list[float]()
    for number, name in enumerate(estimate.names):
        device, sigma, true = estimate.device(name), estimate.sigmas(name), devices[name]
        focals.append(float(np.log(device.lens[0] / true.focal_px[0])))
        centres.append(device.lens[1:3] - true.principal_point_px)
        relative += [focals[-1] / sigma[0], *(centres[-1] / sigma[1:3])]
        if number:
            step = device.pose.local(poses[name].scaled(1 / unit))
            free = sigma[PER_DEVICE : PLACE.stop] > 1e-5  # the second one's distance is the unit
            relative += (step[free] / sigma[PER_DEVICE : PLACE.stop][free]).tolist()
    return np.array(focals), np.array(centres), np.array(relative)


def _truth(station: Mapping[Pair, ThingStation], first: str) -> tuple[dict[str, Pose], dict[str, Intrinsics]]:
    """Poses, X_first = R X_device + t, and intrinsics of all devices."""
    poses: dict[str, Pose] = {}
    devices: dict[str, Intrinsics] = {}
    for (camera, projector), seen in station.items():
        rig = seen.calibration
        poses[camera], poses[projector] = seen.place, seen.place @ rig.pose.inverse()
        devices[camera], devices[projector] = rig.camera, rig.projector
    back = poses[first].inverse()
    return {name: back @ pose for name, pose in poses.items()}, devices


if __name__ == "__main__":
    main()
