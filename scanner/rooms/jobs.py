"""The job of a room: from stations that exist, or live.

Stations of a room one after the other: whether each overlaps the earlier ones, where to stand next.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from calib.geometry import Calibration, Pose
from calib.numerics import Bools
from calib.refusal import RefusalError
from calib.registration import Group, Pair, register
from scanner.configuration import Config
from scanner.exporting import open3d
from scanner.results import Decoded, Job
from scanner.rooms.contents import SolvedRoom
from scanner.rooms.corner_rig import SeenCorner, corner_in, rig_of
from scanner.rooms.epipolar_lines import of_another_rig
from scanner.rooms.save import save_room
from scanner.rooms.scene_rig import guide_without_corner, rig_from_scene, rig_from_stations
from scanner.rooms.solve import CaptureView, segment_capture, solve_room
from scanner.rooms.upright import upright
from scanner.stations import RigStart, check_stations, given_rig, read_stations, take_stations
from scanner.ui import SILENT, Terminal

_BINS = 36
_LEAST_OPEN_DEG = 30.0
_LEAST_OVERLAP = 0.1
_COMMON = 1 / 3  # share of a view that the next station should still see
_PATIENCE_S = 30.0  # longest wait for advice between stations


def take_room(config: Config, number: int, folder: Path, terminal: Terminal) -> tuple[list[Decoded], RigStart]:
    """Stations from this many places, or fewer if the operator ends, and the rig by them. Raises DeviceError,
    RefusalError.
    """
    captures: list[Decoded] = []
    corners: dict[int, SeenCorner] = {}
    comparison = StationComparison()
    for step, capture in enumerate(take_stations(config, number, folder, terminal)):
        captures.append(capture)
        try:
            corners[step] = corner_in(capture, config)
        except RefusalError:
            if not corners:
                terminal.show(f"{capture.name} shows no corner; without any, three stations must share what they see.")
                if len(captures) < number:
                    terminal.show(guide_without_corner(captures, config, terminal, "rig"))
        if corners:
            with terminal.step("Comparing with earlier stations"):
                guidance = comparison.guidance(captures, rig_of(corners, captures).calibration)
            for sentence in guidance:
                terminal.show(sentence)
    return captures, rig_of(corners, captures) if corners else rig_from_scene(captures, config, terminal)


@dataclass
class StationComparison:
    """Comparison of the newest station with those before it, or with as many of the last ones as time allows.

    `patience_s`: largest duration. `pair_s`: duration per pair the last time. `compare`: makes the sentences, by
    default those about a room.
    """

    patience_s: float = _PATIENCE_S
    pair_s: float = 0.0
    compare: Callable[[Sequence[Decoded], Calibration], list[str]] = field(default_factory=lambda: _guidance)

    def guidance(self, captures: Sequence[Decoded], calibration: Calibration) -> list[str]:
        """Sentences about the newest stations: in a room, their overlap, and where to go next."""
        began = time.monotonic()
        chosen = captures[len(captures) - self.within_patience(len(captures)) :]
        sentences = self.compare(chosen, calibration)
        self.pair_s = (time.monotonic() - began) / max(1, _pairs(len(chosen)))
        return sentences

    def within_patience(self, count: int) -> int:
        """How many of this many stations there is time for, at least two; every pair is compared."""
        return next((n for n in range(count, 2, -1) if self.pair_s * _pairs(n) <= self.patience_s), min(count, 2))


def _pairs(stations: int) -> int:
    return stations * (stations - 1) // 2


def _guidance(captures: Sequence[Decoded], calibration: Calibration) -> list[str]:
    newest = len(captures) - 1
    if newest == 0:
        return [f"Next: {_turn(calibration, 'to either side')}"]
    changed = of_another_rig([capture.matches for capture in captures], calibration)
    if newest in changed or (newest == 1 and changed):
        return [
            f"{captures[-1].name} was taken with another rig than the stations before it, and will be left out: "
            f"{(changed.get(newest) or changed[0]).message}. Camera, projector, zoom and focus have to stay as they "
            "are."
        ]
    views = [segment_capture(capture, calibration) for capture in captures]
    registration = register([view.view for view in views], changed)
    group = next((candidate for candidate in registration.groups if newest in candidate.stations), None)
    if group is None:
        return [
            f"{captures[-1].name} overlaps none of the stations before it. It will be left out unless a later one "
            f"connects them: go back to where {captures[-2].name} stood, and {_turn(calibration, 'to one side')}"
        ]
    shared = [pair for pair in registration.pairs if newest in (pair.first, pair.second)]
    overlap = [_overlaps(captures, shared, newest)]
    return [*overlap, _next(views, group, newest, calibration)]


def _overlaps(captures: Sequence[Decoded], shared: Sequence[Pair], newest: int) -> str:
    overlap_texts = [
        f"{captures[pair.first if pair.second == newest else pair.second].name} by {pair.overlap:.0%}"
        for pair in sorted(shared, key=lambda pair: -pair.overlap)
    ]
    weak = (
        " That is little: put another station in between."
        if max(shared_pair.overlap for shared_pair in shared) < _LEAST_OVERLAP
        else ""
    )
    return f"{captures[newest].name} overlaps {', '.join(overlap_texts)}.{weak}"


def _next(views: Sequence[CaptureView], group: Group, newest: int, calibration: Calibration) -> str:
    """The direction to turn the rig, towards what has not been seen."""
    turn, _ = upright(group.places, group.planes, np.ones(len(group.planes)))
    places = {k: turn @ place for k, place in zip(group.stations, group.places, strict=True)}
    middle = np.mean([place.translation[:2] for place in places.values()], axis=0)
    open_bins = ~_seen_all_round(views, places, middle)
    width = 360.0 / _BINS
    ahead = places[newest].rotation[:2, 2]
    looked = int(np.degrees(np.arctan2(ahead[1], ahead[0])) % 360 / width)
    leftmost = next((k for k in range(_BINS) if open_bins[(looked + k) % _BINS]), None)
    right = next((k for k in range(_BINS) if open_bins[(looked - k) % _BINS]), None)
    if leftmost is None or right is None or np.count_nonzero(open_bins) * width < _LEAST_OPEN_DEG:
        return "Everything around has been seen. Further stations close the loop or add detail."
    return f"Next: {_turn(calibration, 'to the left' if leftmost <= right else 'to the right')}"


def _seen_all_round(views: Sequence[CaptureView], places: dict[int, Pose], middle: np.ndarray) -> Bools:
    """Which directions from the middle (2,) have something that was seen, (bins,)."""
    count = np.zeros(_BINS)
    for k, place in places.items():
        points = views[k].view.points.reshape(-1, 3)[::50].astype(np.float64)
        points = place @ points[np.isfinite(points[:, 2])]
        azimuth = np.degrees(np.arctan2(points[:, 1] - middle[1], points[:, 0] - middle[0])) % 360
        count += np.bincount((azimuth * _BINS / 360).astype(np.int64) % _BINS, minlength=_BINS)
    return count > 0.1 * np.median(count[count > 0])


def _turn(calibration: Calibration, side: str) -> str:
    """By how much, so that a third of the view stays the same."""
    lit = min(
        _field_deg(calibration.camera.width, calibration.camera.focal_px[0]),
        _field_deg(calibration.projector.width, calibration.projector.focal_px[0]),
    )
    return (
        f"turn the rig by about {5 * round((1 - _COMMON) * lit / 5)}° {side}; a third of what it sees stays the same."
    )


def _field_deg(width: int, focal_px: float) -> float:
    return float(np.degrees(2 * np.arctan(width / (2 * focal_px))))


def scan_room(
    config: Config,
    out: Path,
    *,
    stations: Sequence[Path] | int,
    calibration: Path | None = None,
    overwrite: bool = False,
    terminal: Terminal = SILENT,
) -> SolvedRoom:
    """Join `stations` of one unchanged rig, in any order; or capture that many, between which it is moved as a
    whole. Without a `calibration`, corners that `stations` show calibrate the rig, or what their pictures share.

    Raises InputError, DeviceError, RefusalError.
    """
    config.principal_point(config.camera_size)
    open3d()  # fail early if it is missing
    known = given_rig(calibration, config) if calibration else None
    if isinstance(stations, int):
        check_stations(config, stations, terminal)

    def acquire(folder: Path) -> tuple[list[Decoded], RigStart]:
        if isinstance(stations, int):
            return take_room(config, stations, folder, terminal)
        captures = read_stations(stations, config, terminal, known.given if known else None)
        return captures, known or rig_from_stations(captures, config, terminal)

    def solve(acquired: tuple[list[Decoded], RigStart]) -> SolvedRoom:
        captures, start = acquired
        if any(capture.only_axis for capture in captures):
            start = replace(start, uncertainty=None)  # one axis fits the epipolar lines of any rig
        return solve_room(captures, start, config, terminal)

    job = Job(acquire, solve, lambda room, folder: save_room(room, folder, config, terminal))
    return job.run(config, out, is_live=isinstance(stations, int), overwrite=overwrite, terminal=terminal)
