"""Networks in synthetic rooms: errors of focal lengths and poses, errors over sigmas, and time.

    python benchmarks/bench_network.py --rooms 10 --sizes 2x1 1x2 2x2 4x4 --wavy 0.002

Matches are computed without rendering, with 0.05 projector px of noise and labelled faces; walls are 0.3° off square,
lenses are random; `--wavy` gives walls waves, `--keystone` makes one edge of the first projector's picture longer than
the opposite one, `--turned` turns the first camera before it sees the last projector, and says what is told of it.
Networks of which a warped picture, or a device that was moved, is named count as refused. 'error/sigma' is the root
mean square of focal lengths, principal points and places over their sigmas, 'worst' the largest one. 'bound' is what
the median error of focal lengths would be at the Cramér–Rao bound, of noise alone.
"""

import argparse
import time
from collections import Counter
from dataclasses import replace

import numpy as np
from cramer_rao import bound_of_network

from calib.networks import NetworkEstimate, estimate_network
from calib.numerics import SIGMA_PER_MEDIAN
from calib.refusal import RefusalError
from calib.synthetic import RoomOptions, SyntheticNetwork, random_network, with_turned_camera


def errors(estimate: NetworkEstimate, network: SyntheticNetwork) -> tuple[list[float], list[float], list[float]]:
    """Errors of focal lengths in per cent, of positions in millimetres, and all in sigmas."""
    first, second = (network.poses[name] for name in estimate.seed)
    unit = float(np.linalg.norm(second.translation - first.translation))
    focals, places, relative = [], [], []
    for name in estimate.names:
        device, sigma, true = estimate.device(name), estimate.sigmas(name), network.devices[name]
        focal = float(np.log(device.lens[0] / true.focal_px[0]))
        focals.append(100 * abs(focal))
        relative += [focal / sigma[0], *((device.lens[1:3] - true.principal_point_px) / sigma[1:3])]
        if name != estimate.names[0]:
            off = device.pose.translation * unit - first.inverse() @ network.poses[name].translation
            places.append(1000 * float(np.linalg.norm(off)))
            relative += list(off / unit / sigma[11:])
    return focals, places, [float(value) for value in relative]


def with_keystone(network: SyntheticNetwork, share: float) -> SyntheticNetwork:
    """The first projector's picture has an upper edge that is longer than the lower one by a share."""
    width, height = network.devices["projector1"].size
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    captures = dict(network.captures)
    for pair, matches in network.captures.items():
        if pair[1] == "projector1":
            off = matches.projector_px - centre
            shown = centre + off / (1 + share * off[:, 1:] / height)
            captures[pair] = replace(matches, projector_px=shown)
    return replace(network, captures=captures)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--rooms", type=int, default=10)
    parser.add_argument("--wavy", type=float, default=0.0, help="of the walls, root mean square in metres")
    parser.add_argument("--keystone", type=float, default=0.0, help="of the first projector, 0.01 for one per cent")
    parser.add_argument("--sizes", nargs="+", default=["2x1", "1x2", "2x2", "4x4"], metavar="CAMERASxPROJECTORS")
    parser.add_argument("--turned", type=float, default=0.0, help="degrees about a random axis")
    args = parser.parse_args()
    options = RoomOptions(boxes=2, count=40_000, wavy=args.wavy)
    print("            focals, %                  places, mm       error/sigma   worst  processor s  per pair  refused")
    print("            median   worst    bound    median   worst")
    for size in args.sizes:
        cameras, projectors = (int(count) for count in size.split("x"))
        focals: list[float] = []
        places: list[float] = []
        relative: list[float] = []
        bounds: list[float] = []
        costs, refused, reasons = [], 0, Counter[str]()
        for seed in range(args.rooms):
            network = random_network(np.random.default_rng(seed), cameras, projectors, options)
            network = with_keystone(network, args.keystone) if args.keystone else network
            if args.turned:
                axis = np.random.default_rng([seed, 7]).normal(size=3)
                turn = np.radians(args.turned) * axis / np.linalg.norm(axis)
                network = with_turned_camera(network, ("camera1", f"projector{projectors}"), turn)
            sizes = {name: device.size for name, device in network.devices.items()}
            start = time.process_time()
            try:
                estimate = estimate_network(network.captures, sizes)
            except RefusalError as refusal:
                refused += 1
                reasons[refusal.finding.kind.name] += 1
                continue
            if estimate.warps:
                refused += 1
                reasons[f"{estimate.warps.moved} moved" if estimate.warps.moved else "warped"] += 1
                continue
            costs.append(time.process_time() - start)
            bounds.extend(100 * bound_of_network(network, estimate.names, options.noise_px) / SIGMA_PER_MEDIAN)
            for total, own in zip((focals, places, relative), errors(estimate, network), strict=True):
                total.extend(own)
        if reasons:
            print(f"{size:9s}  refused: {', '.join(f'{reason} {count}' for reason, count in reasons.most_common())}")
        if not costs:
            continue
        print(
            f"{size:9s} {np.median(focals):8.3f} {max(focals):8.3f} {np.median(bounds):8.3f}"
            f" {np.median(places):8.2f} {max(places):8.2f}     {np.sqrt(np.mean(np.square(relative))):8.2f}"
            f" {np.abs(relative).max():7.2f}"
            f" {np.median(costs):11.1f} {np.median(costs) / cameras / projectors:9.2f} {refused:8d}",
            flush=True,
        )


if __name__ == "__main__":
    main()
