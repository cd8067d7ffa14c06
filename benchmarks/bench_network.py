"""Networks in synthetic rooms: errors of focal lengths and poses, errors over sigmas, and time.

    python benchmarks/bench_network.py --rooms 10 --sizes 2x1 1x2 2x2 4x4 --wavy 0.002
    python benchmarks/bench_network.py --rooms 10 --sizes 2x1 1x2 2x2 --rendered [--set rig.interreflection=true ...]

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
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml
from cramer_rao import bound_of_network

from calib.geometry import Calibration, Intrinsics, Pose
from calib.networks import NetworkEstimate, estimate_network
from calib.numerics import SIGMA_PER_MEDIAN
from calib.refusal import RefusalError
from calib.synthetic import RoomOptions, SyntheticNetwork, random_network, with_turned_camera
from scanner.configuration import load_config
from scanner.io import read_calibration
from scanner.networks import scan_network
from scanner.ui import SILENT

_HALL = Path(__file__).parents[1] / "configs/hall-sim.yaml"


@dataclass(frozen=True)
class Truth:
    """True devices and poses, X_first = R X_device + t, by name, in one unit."""

    devices: Mapping[str, Intrinsics]
    poses: Mapping[str, Pose]


@dataclass
class Row:
    """What the networks of one size came to: errors of focal lengths in per cent, of positions in millimetres, both
    over their sigmas, at the Cramér–Rao bound, and costs in processor seconds.
    """

    focals: list[float] = field(default_factory=list)
    places: list[float] = field(default_factory=list)
    relative: list[float] = field(default_factory=list)
    bounds: list[float] = field(default_factory=list)
    costs: list[float] = field(default_factory=list)
    refused: Counter[str] = field(default_factory=Counter)

    def add(self, estimate: NetworkEstimate, truth: Truth) -> None:
        """Add the errors of one network."""
        first, second = (truth.poses[name] for name in estimate.seed)
        unit = float(np.linalg.norm(second.translation - first.translation))
        for name in estimate.names:
            device, sigma, true = estimate.device(name), estimate.sigmas(name), truth.devices[name]
            focal = float(np.log(device.lens[0] / true.focal_px[0]))
            self.focals.append(100 * abs(focal))
            self.relative += [focal / sigma[0], *((device.lens[1:3] - true.principal_point_px) / sigma[1:3])]
            if name != estimate.names[0]:
                off = device.pose.translation * unit - first.inverse() @ truth.poses[name].translation
                self.places.append(1000 * float(np.linalg.norm(off)))
                self.relative += list(off / unit / sigma[11:])

    def show(self, size: str, pairs: int) -> None:
        """Print it."""
        if self.refused:
            reasons = ", ".join(f"{reason} {count}" for reason, count in self.refused.most_common())
            print(f"{size:9s}  refused: {reasons}")
        if not self.costs:
            return
        bound = f"{np.median(self.bounds):8.3f}" if self.bounds else "       –"
        print(
            f"{size:9s} {np.median(self.focals):8.3f} {max(self.focals):8.3f} {bound}"
            f" {np.median(self.places):8.2f} {max(self.places):8.2f}"
            f"     {np.sqrt(np.mean(np.square(self.relative))):8.2f} {np.abs(self.relative).max():7.2f}"
            f" {np.median(self.costs):11.1f} {np.median(self.costs) / pairs:9.2f} {self.refused.total():8d}",
            flush=True,
        )


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


def made_up(row: Row, size: tuple[int, int], args: argparse.Namespace, seed: int) -> None:
    """Add a network whose matches are made without rendering."""
    cameras, projectors = size
    options = RoomOptions(boxes=2, count=40_000, wavy=args.wavy)
    network = random_network(np.random.default_rng(seed), cameras, projectors, options)
    network = with_keystone(network, args.keystone) if args.keystone else network
    if args.turned:
        axis = np.random.default_rng([seed, 7]).normal(size=3)
        turn = np.radians(args.turned) * axis / np.linalg.norm(axis)
        network = with_turned_camera(network, ("camera1", f"projector{projectors}"), turn)
    sizes = {name: device.size for name, device in network.devices.items()}
    start = time.process_time()
    estimate = estimate_network(network.captures, sizes)
    if estimate.warps:
        row.refused[f"{estimate.warps.moved} moved" if estimate.warps.moved else "warped"] += 1
        return
    row.costs.append(time.process_time() - start)
    row.bounds.extend(100 * bound_of_network(network, estimate.names, options.noise_px) / SIGMA_PER_MEDIAN)
    row.add(estimate, Truth(network.devices, network.poses))


def rendered(row: Row, size: tuple[int, int], args: argparse.Namespace, seed: int) -> None:
    """Add a network of rendered frames."""
    cameras, projectors = size
    document = yaml.safe_load(_HALL.read_text(encoding="utf-8"))
    for role, count in (("cameras", cameras), ("projectors", projectors)):
        document["rigs"][role] = dict(list(document["rigs"][role].items())[:count])
    with TemporaryDirectory() as folder:
        path, out = Path(folder) / "hall.yaml", Path(folder) / "hall"
        path.write_text(yaml.safe_dump(document), encoding="utf-8")
        config = load_config(path, [f"rig.seed={seed}", *args.set])
        start = time.process_time()
        network = scan_network(config, out, terminal=SILENT)
        row.costs.append(time.process_time() - start)
        rigs = {
            (camera, projector): read_calibration(out / "captures" / f"{camera}-{projector}" / "truth.yaml")
            for camera, projector in network.captures.decoded
        }
    row.add(network.estimate, _truth(rigs, network.estimate.names[0]))


def _truth(rigs: Mapping[tuple[str, str], Calibration], first: str) -> Truth:
    """Of true calibrations of pairs."""
    devices: dict[str, Intrinsics] = {}
    poses = {first: Pose(np.eye(3), np.zeros(3))}
    for (camera, projector), rig in rigs.items():
        devices[camera], devices[projector] = rig.camera, rig.projector
    while len(poses) < len(devices):
        for (camera, projector), rig in rigs.items():
            if camera in poses:
                poses[projector] = poses[camera] @ rig.pose.inverse()
            elif projector in poses:
                poses[camera] = poses[projector] @ rig.pose
    return Truth(devices, poses)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--rooms", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--wavy", type=float, default=0.0, help="of the walls, root mean square in metres")
    parser.add_argument("--keystone", type=float, default=0.0, help="of the first projector, 0.01 for one per cent")
    parser.add_argument("--sizes", nargs="+", default=["2x1", "1x2", "2x2", "4x4"], metavar="CAMERASxPROJECTORS")
    parser.add_argument("--turned", type=float, default=0.0, help="degrees about a random axis")
    parser.add_argument("--rendered", action="store_true")
    parser.add_argument("--set", nargs="+", default=[], metavar="KEY=VALUE", help="of the rendered hall")
    args = parser.parse_args()
    print("            focals, %                  places, mm       error/sigma   worst  processor s  per pair  refused")
    print("            median   worst    bound    median   worst")
    for name in args.sizes:
        cameras, projectors = (int(count) for count in name.split("x"))
        row = Row()
        for seed in range(args.first, args.first + args.rooms):
            try:
                (rendered if args.rendered else made_up)(row, (cameras, projectors), args, seed)
            except RefusalError as refusal:
                row.refused[refusal.finding.kind.name] += 1
        row.show(name, cameras * projectors)


if __name__ == "__main__":
    main()
