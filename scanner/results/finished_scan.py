"""A result folder read back: the calibration, and the cloud with the camera pixel and the match of every point."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Calibration, Matches, intersect
from calib.numerics import Floats, Ints
from scanner.errors import InputError
from scanner.io import MATCHES_FILE, read_calibration, read_cloud, read_matches
from scanner.results.names import CALIBRATION_FILE, CLOUD_FILE
from scanner.results.older_results import find_matches, same_points

# This many points of a cloud suffice to check that it comes from these matches.
_SAMPLE = 1000


@dataclass(frozen=True)
class FinishedScan:
    """A finished scan, as read from its files. Row i of every array, and match i, belong to one point.

    `points` (N, 3) in the camera's frame and the calibration's unit, `normals` (N, 3), `colours` (N, 3) RGB; `pixel`
    (N, 2): column and row of the camera's image, no two alike; `matched` is how many matches the scan had.
    """

    calibration: Calibration
    matches: Matches
    matched: int
    points: Floats
    normals: Floats
    colours: NDArray[np.uint8]
    pixel: Ints

    def __len__(self) -> int:
        return len(self.points)

    @property
    def unit(self) -> str:
        """The unit of `points`; 'baseline' if no length is known."""
        return self.calibration.unit

    def __getitem__(self, chosen: Ints) -> "FinishedScan":
        """The points of these numbers (K,), with everything that belongs to them."""
        return replace(
            self,
            matches=self.matches[chosen],
            points=self.points[chosen],
            normals=self.normals[chosen],
            colours=self.colours[chosen],
            pixel=self.pixel[chosen],
        )


def read_calibration_of(folder: Path) -> Calibration:
    """The calibration of a result folder. Raises InputError if it is no result or its capture was refused."""
    if (folder / CALIBRATION_FILE).is_file():
        return read_calibration(folder / CALIBRATION_FILE)
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a result folder, found {'a file' if folder.exists() else 'nothing'}")
    if (folder / MATCHES_FILE).is_file():
        raise InputError(
            f"{folder}: has matches but no {CALIBRATION_FILE}: no trustworthy calibration was possible from this "
            "capture; its report.html says why and what to do"
        )
    raise InputError(f"{folder}: expected a result folder, with {CALIBRATION_FILE} and {CLOUD_FILE}, found neither")


def read_finished_scan(folder: Path) -> FinishedScan:
    """Everything of a result folder but the recording. Raises InputError if a file is missing or of another scan."""
    calibration = read_calibration_of(folder)
    cloud = read_cloud(folder / CLOUD_FILE)
    matches = read_matches(folder)
    if not len(cloud):
        raise InputError(f"{folder}: the cloud is empty")
    own = find_matches(cloud.points, matches, calibration) if cloud.match is None else cloud.match
    if own is None or own.min() < 0 or own.max() >= len(matches):
        raise _of_another_scan(folder)
    matched = matches[own]
    pixel = np.rint(matched.camera_px).astype(np.int64)
    if not _has_own_pixels(pixel, calibration) or not _is_where_rays_meet(cloud.points, matched, calibration):
        raise _of_another_scan(folder)
    return FinishedScan(calibration, matched, len(matches), cloud.points, cloud.normals, cloud.colours, pixel)


def _of_another_scan(folder: Path) -> InputError:
    return InputError(
        f"{folder}: {CLOUD_FILE} does not follow from {MATCHES_FILE} and {CALIBRATION_FILE}: one of them was "
        "changed or comes from another scan; make the result again with 'scan replay' or 'scan calibrate'"
    )


def _has_own_pixels(pixel: Ints, calibration: Calibration) -> bool:
    """Whether pixels (N, 2) are in the camera's image and unique."""
    size = calibration.camera.size
    if np.any((pixel < 0) | (pixel >= size)):
        return False
    return len(np.unique(pixel[:, 1] * size.width + pixel[:, 0])) == len(pixel)


def _is_where_rays_meet(points: Floats, matched: Matches, calibration: Calibration) -> bool:
    """Whether points (N, 3) are what their matches give, judged by some of them."""
    sample = np.linspace(0, len(points) - 1, _SAMPLE).astype(np.int64)
    met = intersect(matched[sample], calibration)
    return bool(np.all(met.in_front) and np.all(same_points(points[sample], met.points)))
