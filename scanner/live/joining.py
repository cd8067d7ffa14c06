"""Kept clouds become stations with their recordings, and are joined as they come, which shows what is missing."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import numpy as np

from calib.geometry import Calibration, Matches, Size, cross_epipolar_lines
from calib.pointcloud import build_cloud
from scanner.capture import CaptureMetadata, Stream, record
from scanner.io import MATCHES_FILE, write_calibration, write_matches, write_ply
from scanner.live.cloud import LiveCloud
from scanner.live.sequence import LiveSequence
from scanner.live.watching import Newest
from scanner.objects import advice_on, brief, outside_text, stations_outside
from scanner.results import CALIBRATION_FILE, CAPTURE_FOLDER, CLOUD_FILE, Decoded, GivenMatches
from scanner.rooms import StationComparison

_FEWEST = 4  # stations of a thing; with fewer, background and thing are not separable
_LEAVING_S = 60.0


def joined_text(captures: Sequence[Decoded], calibration: Calibration) -> list[str]:
    """Which stations of a thing have their places by now."""
    if len(captures) < _FEWEST:
        return []
    outside = stations_outside(captures, calibration)
    placed = len(captures) - len(outside)
    if placed < 2:
        return [f"No two stations fit together yet: {outside_text(outside)}. {advice_on(outside)}"]
    if not outside:
        return [f"{placed} stations fit together."]
    names = brief([capture.name for capture in outside])
    return [f"{placed} stations fit together, but not yet {names}: put stations between them and the others."]


@contextmanager
def joining(
    calibration: Calibration, tell: Callable[[str], None], *, of_room: bool
) -> Iterator[Callable[[Sequence[Decoded]], None]]:
    """A function that takes all stations kept so far, and joins the newest ones in a thread.

    The last ones are joined before the context ends, if that takes at most a minute. Errors are reported and not
    raised, because the stations are safe.
    """
    slot = Newest[Sequence[Decoded]]()
    comparison = StationComparison() if of_room else StationComparison(compare=joined_text)

    def join() -> None:
        while (captures := slot.take()) is not None:
            try:
                for sentence in comparison.guidance(captures, calibration):
                    tell(sentence)
            except Exception as error:
                tell(f"The stations could not be joined yet: {error}")

    thread = Thread(target=join, name="joining", daemon=True)
    thread.start()
    try:
        yield slot.put
    finally:
        slot.finish()
        thread.join(_LEAVING_S)
        if thread.is_alive():
            tell("Joining the last stations takes longer than a minute, and is left to the command below.")


def matches_of(cloud: LiveCloud, axis: int, calibration: Calibration) -> Matches:
    """The other coordinate is where the epipolar line crosses the stripe; `sigma_px` is along that line."""
    row, column = np.divmod(cloud.pixel, cloud.reason.shape[1])
    camera_px = np.stack([column, row], axis=1).astype(np.float64)
    known_px = cloud.coordinate.ravel()[cloud.pixel].astype(np.float64)
    crossing = cross_epipolar_lines(camera_px, known_px, axis, calibration)
    sigma_px = np.sqrt(cloud.variance.ravel()[cloud.pixel]) / np.maximum(crossing.sine, 1e-6)
    inside = np.all(
        np.abs(crossing.projector_px + 0.5 - np.array(calibration.projector.size) / 2)
        <= np.array(calibration.projector.size) / 2,
        axis=1,
    )
    there = np.flatnonzero(crossing.in_front & inside)
    return Matches(camera_px, crossing.projector_px, None, sigma_px)[there]


def keep_station(
    cloud: LiveCloud,
    sequence: LiveSequence,
    calibration: Calibration,
    devices: Mapping[str, str],
    folder: Path,
    name: str,
) -> Decoded:
    """Write it into `folder`, which is made. Raises OSError."""
    sizes = Size(*calibration.projector.size), Size(*calibration.camera.size)
    frames = iter(list(zip(sequence.patterns, cloud.taken.frames, strict=True)))
    stream = Stream(sequence.patterns, *sizes, frames, {"devices": dict(devices)})
    for _ in record(stream, folder / CAPTURE_FOLDER).frames:
        pass
    matches = matches_of(cloud, sequence.number, calibration)
    write_matches(folder / MATCHES_FILE, matches, None, sequence.axis)
    write_calibration(folder / CALIBRATION_FILE, calibration)
    made = build_cloud(matches, cloud.picture, calibration)
    write_ply(folder / CLOUD_FILE, made, match=made.match)
    metadata = CaptureMetadata(sizes[1], sizes[0], sequence.patterns)
    return Decoded(metadata, matches, GivenMatches(cloud.picture, only_axis=sequence.axis), name)
