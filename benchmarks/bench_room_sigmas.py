"""Errors over sigmas of whole rooms, by the estimate alone, in the rooms of `bench_room.py`.

    python benchmarks/bench_room_sigmas.py [--rooms 9] [--draws 3] [--smooth-px 0]

Errors in one room correlate (five angles between its walls, and all poses through one focal length), so a few rooms are
not conclusive. Here, noise is drawn several times for each room, and only the estimate is repeated, with known planes,
from poses 10 mm and 0.2° off. `--smooth-px`: smooth errors assumed in the sigmas; the matches have none. 'bent': number
of draws per plane judged bent, where all are flat.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from calib.estimation import Cells, Shifts, into_cells
from calib.geometry import Plane
from calib.numerics import Floats, Ints
from calib.refinement import Knowledge, State
from calib.rooms import RigPrior, Room, RoomEstimate, angle_deg, estimate_room
from hw.errors import DeviceError

sys.path.append(str(Path(__file__).parents[1]))
from tests.support.states import device_of
from tests.support.whole_room import TrueStation, stations

_NOISE_PX, _CENTRE_SIGMA_PX = 0.03, 35.0
_LEAST, _LEAST_SHARE = 200, 0.02  # matches on a plane of a station, as in `calib.registration.range_view`
_WALLS, _OF_A_BLOCK = 6, 6
_CROSSING = 0.1  # largest scalar product of two perpendicular normals
_OFF_M, _TURNED = 0.01, 0.003  # displacement of the start


@dataclass(frozen=True, eq=False)
class Made:
    """A room in baselines, in its first camera's frame; `surface` of each plane, and `label` of each station's matches
    as plane indices, −1 for none.
    """

    true: Sequence[TrueStation]
    room: Room
    surface: Ints
    labels: Sequence[Ints]

    @classmethod
    def of(cls, true: Sequence[TrueStation]) -> "Made":
        scene, rig, first = true[0].scene, true[0].calibration, true[0].place
        flat = _WALLS + _OF_A_BLOCK * len(scene.blocks)
        normals = scene.normals(np.arange(flat, dtype=np.int32), np.zeros((3, flat))).T
        seen = [np.bincount(each.surface[each.surface < flat], minlength=flat) for each in true]
        surface = np.flatnonzero(np.max([count >= max(_LEAST, _LEAST_SHARE * count.sum()) for count in seen], axis=0))
        number = np.full(int(max(each.surface.max() for each in true)) + 1, -1, np.int32)
        number[surface] = np.arange(len(surface))

        def plane(k: int) -> Plane:
            at = scene.points_on(k, np.zeros((2, 1)))[:, 0] - first.translation
            return Plane(first.rotation.T @ normals[k], float(normals[k] @ at) / rig.baseline)

        places = tuple((first.inverse() @ station.place).scaled(1 / rig.baseline) for station in true)
        devices = device_of(rig.camera), device_of(rig.projector)
        state = State(*devices, rig.pose.in_baselines)
        room = Room(state, places, tuple(plane(int(k)) for k in surface))
        return cls(true, room, surface, [number[each.surface] for each in true])

    def cells(self, rng: np.random.Generator) -> list[Cells]:
        """Cells with new noise."""
        found = []
        for each, label in zip(self.true, self.labels, strict=True):
            count = np.bincount(label[label >= 0], minlength=len(self.surface))
            on = np.flatnonzero(count >= max(_LEAST, _LEAST_SHARE * count.sum())).tolist()
            exact = each.matches.projector_px
            noisy = replace(
                each.matches,
                projector_px=exact + _NOISE_PX * rng.standard_normal(exact.shape),
                sigma_px=np.full(len(exact), _NOISE_PX),
            )
            found.append(into_cells(noisy, on, label))
        return found

    def start(self, rng: np.random.Generator) -> Room:
        step = np.zeros(self.room.size)
        off = _OFF_M / self.true[0].calibration.baseline
        for station in range(1, len(self.room.places)):
            step[self.room.place_columns(station)] = rng.normal(size=6) * np.repeat([_TURNED, off], 3)
        for plane in range(len(self.room.planes)):
            step[self.room.plane_columns(plane)] = rng.normal(size=3) * [_TURNED, _TURNED, off]
        return self.room.moved(step)


def estimated(made: Made, rng: np.random.Generator, smooth_px: float) -> RoomEstimate:
    start, rig = made.start(rng), made.true[0].calibration
    centre = (rig.camera.width - 1) / 2, (rig.camera.height - 1) / 2
    known = Knowledge(rig.camera.size, rig.projector.size, centre, _CENTRE_SIGMA_PX, 0.3)
    prior = RigPrior.from_knowledge(known, made.room.rig)
    planes = [tuple(range(len(made.surface)))] * len(made.true)
    shifts = [Shifts(smooth_px=smooth_px)] * len(made.true)
    return estimate_room(made.cells(rng), planes, start.places, start.planes, made.room.rig, prior, shifts=shifts)


def in_sigmas(made: Made, found: RoomEstimate) -> dict[str, Floats]:
    """Errors over sigmas."""
    room = replace(found.room, planes=found.room.planes[: len(made.room.planes)])
    variance = np.diag(found.covariance)[: made.room.size]
    off = room.step_to(made.room) / np.sqrt(np.where(variance > 0, variance, np.nan))
    places = np.concatenate([off[room.place_columns(k)].reshape(2, 3) for k in range(1, len(room.places))])
    errors: dict[str, list[float]] = {"angles of walls": [], "all angles": []}
    for a, b in combinations(range(len(room.planes)), 2):
        product = float(made.room.planes[a].normal @ made.room.planes[b].normal)
        if abs(product) < _CROSSING:
            angle = angle_deg(found, a, b)
            error = (angle.value - (180 - float(np.degrees(np.arccos(product))))) / angle.sigma
            errors["all angles"].append(error)
            if max(made.surface[a], made.surface[b]) < _WALLS:
                errors["angles of walls"].append(error)
    return {"turns": places[::2], "places": places[1::2], **{name: np.array(each) for name, each in errors.items()}}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=9)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--draws", type=int, default=3)
    parser.add_argument("--smooth-px", type=float, default=0.0)
    args = parser.parse_args()
    every: dict[str, list[Floats]] = {}
    draws = bent = 0
    began = time.process_time()
    for seed in range(args.first, args.first + args.rooms):
        try:
            made = Made.of(stations(6, seed, noise_px=0.0, furniture_askew_deg=4.0, ball_bar_m=3.0))
        except DeviceError:
            continue
        for draw in range(args.draws):
            found = estimated(made, np.random.default_rng([seed, draw]), args.smooth_px)
            draws, bent = draws + 1, bent + bool((found.levels.planes > 1).any())
            errors = in_sigmas(made, found)
            for name, values in errors.items():
                every.setdefault(name, []).append(values.ravel())
            print(
                f"{seed:4d}{draw:3d}  " + "  ".join(f"{name} {rms(each):.2f}" for name, each in errors.items()),
                flush=True,
            )
    for name, parts in every.items():
        print(f"error/sigma of {name}, rms: {rms(np.concatenate(parts)):.2f} ({sum(part.size for part in parts)})")
    print(f"bent: in {bent} of {draws} draws; {time.process_time() - began:.0f} s of one processor")


def rms(values: Floats) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


if __name__ == "__main__":
    main()
