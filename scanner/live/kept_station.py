"""A cloud that is kept: a station with its recording, its matches and its cloud, as a scan would leave them."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calib.geometry import Calibration, Matches, Size, cross_epipolar_lines
from calib.pointcloud import build_cloud
from scanner.capture import CaptureMetadata, Stream, record
from scanner.io import MATCHES_FILE, write_calibration, write_matches, write_ply
from scanner.live.cloud import LiveCloud
from scanner.live.sequence import LiveSequence
from scanner.results import CALIBRATION_FILE, CAPTURE_FOLDER, CLOUD_FILE, Decoded, GivenMatches


def matches_of(cloud: LiveCloud, axis: int, calibration: Calibration) -> Matches:
    """The other coordinate is where the epipolar line crosses the stripe; `sigma_px` is along that line."""
    row, column = np.divmod(cloud.pixel, cloud.reason.shape[1])
    camera_px = np.stack([column, row], axis=1).astype(np.float64)
    known_px = cloud.coordinate.ravel()[cloud.pixel].astype(np.float64)
    found = cross_epipolar_lines(camera_px, known_px, axis, calibration)
    sigma_px = np.sqrt(cloud.variance.ravel()[cloud.pixel]) / np.maximum(found.sine, 1e-6)
    inside = np.all(
        np.abs(found.projector_px + 0.5 - np.array(calibration.projector.size) / 2)
        <= np.array(calibration.projector.size) / 2,
        axis=1,
    )
    there = np.flatnonzero(found.in_front & inside)
    return Matches(camera_px, found.projector_px, None, sigma_px)[there]


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
    shown = iter(list(zip(sequence.patterns, cloud.taken.frames, strict=True)))
    stream = Stream(sequence.patterns, *sizes, shown, {"devices": dict(devices)})
    for _ in record(stream, folder / CAPTURE_FOLDER).frames:
        pass
    matches = matches_of(cloud, sequence.number, calibration)
    write_matches(folder / MATCHES_FILE, matches, None, sequence.axis)
    write_calibration(folder / CALIBRATION_FILE, calibration)
    made = build_cloud(matches, cloud.picture, calibration)
    write_ply(folder / CLOUD_FILE, made, match=made.match)
    metadata = CaptureMetadata(sizes[1], sizes[0], sequence.patterns)
    return Decoded(metadata, matches, GivenMatches(cloud.picture, only_axis=sequence.axis), name)
