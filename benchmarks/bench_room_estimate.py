"""Whole rooms: one estimate of rig, poses and planes, on synthetic rooms with ground truth.

    python benchmarks/bench_room_estimate.py [--rooms 30] [--times 6 12 24] [--wavy 0.001] [--tangential 0.0004]

Six stations in a furnished room of 4.5 × 3.6 × 2.6 m, walls off square by 0.3° (normal, each direction), noise of 0.03
to 0.1 projector px, matches straight from points in space. The start is the truth with focals off by 1 %, principal
points by 5 px, places and planes by 30 mm and 0.5° (1 sigma each). The prior of the camera's principal point is the
image's centre ± 50 px. For comparison: the same with the rig fixed to the calibration from one station's corner, and to
the true rig. 'bound' is the Cramér–Rao bound.
"""

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
from cramer_rao import bound_of_room

from calib.geometry import Intrinsics, Matches, Size
from calib.numerics import Floats
from calib.refinement import CAMERA, PROJECTOR, SHARED, State
from calib.refusal import RefusalError
from calib.rooms import (
    Measured,
    RigPrior,
    Room,
    RoomEstimate,
    RoomPrior,
    angle_deg,
    centre_of,
    distance,
    estimate_room,
    gap,
    vertex,
)
from calib.self_calibration import PrincipalPoint, self_calibrate
from calib.synthetic import RoomOptions, SyntheticRoom, random_room

sys.path.append(str(Path(__file__).parents[1]))
from tests.support.known_rigs import cells_of, disturbed, knowledge_of, true_room

_CENTRE_SIGMA_PX, _SQUARENESS_DEG = 50.0, 0.3
_WEAK = 3e-3  # metres: stations with a larger sigma in some direction are counted separately
_APART = 0.3  # baselines: largest distance of two estimates of a vertex
_FACING, _CROSSING = -0.98, 0.1  # scalar products of the normals of facing and of perpendicular planes


@dataclass
class Errors:
    """Errors of one estimate: pose errors (mm, degrees), and whether each station is determined in all directions."""

    millimetres: list[float] = field(default_factory=list)
    degrees: list[float] = field(default_factory=list)
    held: list[bool] = field(default_factory=list)

    def add(self, truth: Room, found: RoomEstimate, held: list[bool], unit_m: float) -> None:
        step = found.room.step_to(truth)
        for station in range(1, len(truth.places)):
            part = step[truth.place_columns(station)]
            self.millimetres.append(1000 * unit_m * float(np.linalg.norm(part[3:])))
            self.degrees.append(float(np.degrees(np.linalg.norm(part[:3]))))
        self.held += held

    def row(self) -> str:
        if not self.held:
            return "–"
        held = np.array(self.held)
        of_held, turn = np.array(self.millimetres)[held], np.array(self.degrees)[held]
        return (
            f"{_rms(of_held):9.3f}{np.median(of_held):9.3f}{_rms(turn):11.4f}   ({held.sum()} of {len(held)} stations)"
        )


def _centre(size: Size) -> tuple[float, float]:
    return (size.width - 1) / 2, (size.height - 1) / 2


def rooms(
    count: int, matches: int, wavy: float, balls: int, tangential: float
) -> Iterator[tuple[SyntheticRoom, float, int]]:
    options = RoomOptions(count=matches, wavy=wavy, balls=balls)
    for seed in range(count):
        rng = np.random.default_rng(seed)
        noise_px = float(np.exp(rng.uniform(np.log(0.03), np.log(0.1))))
        camera, projector = (
            _with_tangential(device, np.random.default_rng([seed, 3 + i]).normal(0, tangential, 2))
            for i, device in enumerate((options.camera, options.projector))
        )
        yield random_room(rng, options, noise_px=noise_px, camera=camera, projector=projector), noise_px, seed


def _with_tangential(device: Intrinsics, terms: Floats) -> Intrinsics:
    k1, k2, _, _, k3 = device.distortion
    return replace(device, distortion=(k1, k2, float(terms[0]), float(terms[1]), k3))


def corner_calibration(made: SyntheticRoom, rng: np.random.Generator) -> State | None:
    """The rig from one station that sees the floor and two adjacent walls, as a person would choose it."""
    camera, projector = made.calibration.camera.size, made.calibration.projector.size
    for i in rng.permutation(len(made.stations)):
        matches = made.stations[i].matches
        seen = np.bincount(matches.labels[matches.labels >= 0], minlength=6)
        walls = [(a, b) for a in (2, 3) for b in (4, 5) if min(seen[[0, a, b]]) > 0.05 * len(matches)]
        if not walls:
            continue
        face = np.full(len(made.normals) + 1, -1, np.int32)
        face[[0, *walls[0]]] = [0, 1, 2]
        point = PrincipalPoint(_centre(camera), _CENTRE_SIGMA_PX)
        try:
            found = self_calibrate(
                matches.with_faces(face[matches.labels]),
                camera,
                projector,
                principal_point=point,
                squareness_deg=_SQUARENESS_DEG,
            )
        except RefusalError:
            continue
        assert found.uncertainty is not None
        return found.uncertainty.rig
    return None


def lengths(found: RoomEstimate, truth: Room) -> Iterator[tuple[str, Measured, float]]:
    """Estimated and true values by kind: distances of facing planes, angles, edges of the room."""
    true = _exact(found, truth)
    normals = np.stack([plane.normal for plane in truth.planes])
    products = normals @ normals.T
    for a, b in combinations(range(len(normals)), 2):
        if products[a, b] < _FACING:
            yield "gaps", gap(found, a, b), _gap_there(found, truth, a, b)
        elif abs(products[a, b]) < _CROSSING:
            yield "angles", angle_deg(found, a, b), angle_deg(true, a, b).value
    corners = [each for each in combinations(range(len(normals)), 3) if abs(np.linalg.det(normals[list(each)])) > 0.9]
    for first, second in pairwise(corners):
        measured = distance(found, vertex(found, *first), vertex(found, *second))
        if measured.value > _APART:
            yield "vertices", measured, distance(true, vertex(true, *first), vertex(true, *second)).value


def _exact(found: RoomEstimate, truth: Room) -> RoomEstimate:
    return replace(found, fit=replace(found.fit, state=truth))


def _gap_there(found: RoomEstimate, truth: Room, first: int, second: int) -> float:
    """The true distance at the point of measurement."""
    one, other = truth.planes[first], truth.planes[second]
    middle = (centre_of(found, first) + centre_of(found, second)) / 2
    foot = middle - (one.normal @ middle - one.offset) * one.normal
    return abs(float(other.normal @ foot - other.offset))


def accuracy(count: int, matches: int, wavy: float, balls: int, tangential: float) -> None:
    ways = {name: Errors() for name in ("joint estimate", "rig of one corner, held", "true rig, held")}
    bound_mm: list[float] = []
    sigmas: dict[str, list[float]] = {}
    focals: list[Floats] = []
    seconds: list[float] = []
    untied = 0
    for made, noise_px, seed in rooms(count, matches, wavy, balls, tangential):
        truth, numbers = true_room(made)
        cells, plane_of = cells_of(made, numbers)
        start = disturbed(np.random.default_rng([seed, 1]), truth, made)
        unit = made.calibration.baseline
        known = RigPrior.from_knowledge(knowledge_of(made), start.rig)
        corner = corner_calibration(made, np.random.default_rng([seed, 2]))
        begun = time.perf_counter()
        joint = estimate_room(cells, plane_of, start.places, start.planes, start.rig, known, loose=_loose(made, balls))
        seconds.append(time.perf_counter() - begun)
        untied += len(joint.room.planes) - len(truth.planes)
        joint = _of_planes(joint, truth)
        held = _held(joint, unit)
        ways["joint estimate"].add(truth, joint, held, unit)
        for name, rig in (("rig of one corner, held", corner), ("true rig, held", truth.rig)):
            if rig is not None:
                fixed = RigPrior.exactly(rig)
                found = estimate_room(
                    cells, plane_of, start.places, start.planes, rig, fixed, loose=_loose(made, balls)
                )
                ways[name].add(truth, _of_planes(found, truth), held, unit)
        prior = RoomPrior.of(known, (), _SQUARENESS_DEG, truth, (1.0, joint.reach))
        bound = bound_of_room(truth, joint.patches, prior, noise_px)
        for station in np.flatnonzero(held) + 1:
            columns = truth.place_columns(int(station))
            bound_mm.append(1000 * unit * float(np.sqrt(np.trace(bound[columns, columns][3:, 3:]))))
        _add_sigmas(sigmas, joint, truth, held)
        step = joint.room.step_to(truth)
        focals.append(np.abs(step[[CAMERA.start, PROJECTOR.start]]))
        print(f"  room {seed}: {joint.residual_px.max():.4f} px, undetermined {len(joint.undetermined)}", flush=True)
    print(
        f"{count} rooms, {matches} matches a station, walls wavy by {1000 * wavy:g} mm; {np.mean(seconds):.2f} s each"
    )
    print(f"  {'pose error':26}{'rms mm':>9}{'median':>9}{'rms deg':>11}   stations whose sigma is below 3 mm")
    for name, errors in ways.items():
        print(f"  {name:26}{errors.row()}")
    error_mm = np.array(ways["joint estimate"].millimetres)[np.array(ways["joint estimate"].held)]
    least_mm = _rms(np.array(bound_mm))
    if not balls:  # the bound does not include matches on balls
        print(f"  {'bound':26}{least_mm:9.3f}   error over bound {_rms(error_mm) / least_mm:.3f}")
    print(f"  misassigned observations of planes: {untied}")
    print(f"  focals, mean error: {100 * np.mean(focals):.4f} %")
    print("  error / sigma, rms")
    for name, values in sigmas.items():
        print(f"    {name:26}{_rms(np.array(values)):6.2f}   ({len(values)} numbers)")


def _loose(made: SyntheticRoom, balls: int) -> list[Matches]:
    """Matches on balls and on very small planes; none where there are no balls."""
    return [station.matches[station.matches.labels < 0] for station in made.stations] if balls else []


def _of_planes(found: RoomEstimate, truth: Room) -> RoomEstimate:
    """The patches without planes that exist in the estimate only."""
    size = truth.size
    room = replace(found.room, planes=found.room.planes[: len(truth.planes)])
    patches = tuple(patch for patch in found.patches if patch.plane < len(truth.planes))
    fit, problem = replace(found.fit, state=room), replace(found.problem, parts=patches)
    return replace(found, problem=problem, fit=fit, covariance=found.covariance[:size, :size])


def _held(found: RoomEstimate, unit_m: float) -> list[bool]:
    return [
        bool(np.sqrt(np.linalg.eigvalsh(found.place_covariance(i)[3:, 3:])[-1]) * unit_m < _WEAK)
        for i in range(1, len(found.room.places))
    ]


def _add_sigmas(sigmas: dict[str, list[float]], found: RoomEstimate, truth: Room, held: list[bool]) -> None:
    step, sigma = found.room.step_to(truth), np.sqrt(np.diag(found.covariance))
    off = step / np.where(sigma > 0, sigma, np.nan)
    sigmas.setdefault("focals", []).extend(off[[CAMERA.start, PROJECTOR.start]])
    sigmas.setdefault("rig, all", []).extend(off[:SHARED])
    for i, of_station in enumerate(held, start=1):
        columns = truth.place_columns(i)
        sigmas.setdefault("turns", []).extend(off[columns][:3])
        name = "translations" if of_station else "translations, sliding"
        sigmas.setdefault(name, []).extend(off[columns][3:])
    sigmas.setdefault("planes", []).extend(off[truth.plane_columns(0).start :])
    for kind, measured, true in lengths(found, truth):
        sigmas.setdefault(kind, []).append((measured.value - true) / measured.sigma)


def times(stations: list[int]) -> None:
    print("seconds on one core, 10^5 matches a station (cells: from matches to their means)")
    for number in stations:
        made = random_room(np.random.default_rng(1), stations=number)
        truth, numbers = true_room(made)
        begun = time.perf_counter()
        cells, plane_of = cells_of(made, numbers)
        summed = time.perf_counter()
        start = disturbed(np.random.default_rng(2), truth, made)
        known = RigPrior.from_knowledge(knowledge_of(made), start.rig)
        found = estimate_room(cells, plane_of, start.places, start.planes, start.rig, known)
        done = time.perf_counter()
        print(
            f"  {number:3} stations, {len(truth.planes):3} planes, {len(found.patches):3} patches: cells "
            f"{summed - begun:6.2f}, estimate {done - summed:6.2f}",
            flush=True,
        )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=30)
    parser.add_argument("--matches", type=int, default=20_000)
    parser.add_argument("--wavy", type=float, default=0.0, help="metres, standard deviation of the walls' waves")
    parser.add_argument(
        "--balls", type=int, default=0, help="number of balls in the air; they tie stations, as planes do"
    )
    parser.add_argument("--tangential", type=float, default=0.0, help="standard deviation of p1 and p2 of both devices")
    parser.add_argument("--times", type=int, nargs="*", default=[])
    arguments = parser.parse_args()
    if arguments.rooms:
        accuracy(arguments.rooms, arguments.matches, arguments.wavy, arguments.balls, arguments.tangential)
    if arguments.times:
        times(arguments.times)


if __name__ == "__main__":
    main()
