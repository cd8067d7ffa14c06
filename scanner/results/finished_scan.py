"""A result folder read back: the calibration, and the cloud with the camera pixel and the match of every point."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from calib.geometry import Calibration, Matches, intersect
from calib.numerics import Floats, Ints
from calib.pointcloud import NONE, index_grid
from scanner.errors import InputError
from scanner.io import MATCHES_FILE, read_calibration, read_cloud, read_matches
from scanner.results.result_folder import CALIBRATION_FILE, CLOUD_FILE

# Coordinates in the cloud are rounded to 24 bits; relative to a point's distance this is far more than that.
_SAME_POINT = 1e-5


@dataclass(frozen=True)
class FinishedScan:
    """What a scan left behind. Row i of every array, and match i, belong to one point.

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
        """Of `points`; 'baseline' where no length is known."""
        return self.calibration.unit

    @property
    def index_grid(self) -> Ints:
        """Which point each camera pixel has, (H, W), `NONE` for none."""
        camera = self.calibration.camera
        return index_grid(self.pixel, (camera.width, camera.height))


def read_calibration_of(folder: Path) -> Calibration:
    """The calibration of a result folder. Raises InputError if the folder is none or its capture was refused."""
    if (folder / CALIBRATION_FILE).is_file():
        return read_calibration(folder / CALIBRATION_FILE)
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a result folder, found {'a file' if folder.exists() else 'nothing'}")
    if (folder / MATCHES_FILE).is_file():
        raise InputError(
            f"{folder}: has matches but no {CALIBRATION_FILE}: no trustworthy calibration could be had from this "
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
    pixel = np.rint(matches.camera_px).astype(np.int64)
    own = _own_matches(cloud.points, pixel, matches, calibration)
    if own is None or not _all_different(pixel[own], calibration):
        raise InputError(
            f"{folder}: {CLOUD_FILE} does not follow from {MATCHES_FILE} and {CALIBRATION_FILE}: one of them was "
            "changed or comes from another scan; make the result again with 'scan replay' or 'scan calibrate'"
        )
    return FinishedScan(calibration, matches[own], len(matches), cloud.points, cloud.normals, cloud.colours, pixel[own])


def _all_different(pixel: Ints, calibration: Calibration) -> bool:
    taken = np.zeros((calibration.camera.height, calibration.camera.width), np.bool_)
    taken[pixel[:, 1], pixel[:, 0]] = True
    return int(np.count_nonzero(taken)) == len(pixel)


def _own_matches(points: Floats, pixel: Ints, matches: Matches, calibration: Calibration) -> Ints | None:
    """Which match each point (N, 3) was triangulated from, (N,), or None if there is a point that none gives.

    `pixel` (M, 2) is the camera's of each match. Nearly always a point is seen at its own match's pixel. Where the rays
    missed each other by more than that, it is the nearest of the points that are left.
    """
    size = (calibration.camera.width, calibration.camera.height)
    met = intersect(matches, calibration)
    usable = np.flatnonzero(met.in_front & np.all((pixel >= 0) & (pixel < size), axis=1))
    at_pixel = np.full(size[::-1], NONE, np.int64)
    at_pixel[pixel[usable, 1], pixel[usable, 0]] = usable
    seen = np.nan_to_num(np.rint(calibration.camera.project(points)), nan=-1.0).clip(-1, size).astype(np.int64)
    inside = np.all((seen >= 0) & (seen < size), axis=1)
    own = np.where(inside, at_pixel[tuple(np.where(inside[:, None], seen, 0).T[::-1])], NONE)
    tolerance = _SAME_POINT * np.linalg.norm(points, axis=1)
    missed = np.flatnonzero((own == NONE) | ~(np.linalg.norm(met.points[own] - points, axis=1) <= tolerance))
    if len(missed):
        left = np.setdiff1d(usable, np.delete(own, missed))
        if not len(left):
            return None
        apart, nearest = cKDTree(met.points[left]).query(points[missed])
        if np.any(apart > tolerance[missed]):
            return None
        own[missed] = left[nearest]
    return own
