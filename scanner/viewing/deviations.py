"""A comparison of surfaces as something to look at: its points, coloured by their deviations from the reference."""

import json
from pathlib import Path

import numpy as np

from calib.deferred_imports import open3d
from scanner.comparing import CLOUD_FILE, COMPARE_FILE
from scanner.errors import InputError
from scanner.io import read_whole
from scanner.results import Verdict
from scanner.viewing.result import DeviationCloud


def is_comparison(folder: Path) -> bool:
    """Whether a folder is that of a comparison of surfaces which fit in one way."""
    return (folder / CLOUD_FILE).is_file() and (folder / COMPARE_FILE).is_file()


def deviation_cloud(folder: Path) -> tuple[DeviationCloud, Verdict]:
    """The points in the reference's frame, z up, and the verdict. Raises InputError if a file is damaged."""
    try:
        document = json.loads(read_whole(folder / COMPARE_FILE))
        verdict = Verdict(document["grade"], document["verdict"], tuple(document["reasons"]))
        unit, tolerance = str(document["unit"]), document["tolerance"] and float(document["tolerance"]["tolerance"])
        cloud = open3d().t.io.read_point_cloud(str(folder / CLOUD_FILE)).point
        arrays = [cloud[name].numpy() for name in ("positions", "normals", "colors", "deviation")]
    except (ValueError, KeyError, TypeError, RuntimeError) as error:
        raise InputError(f"{folder}: expected a comparison of surfaces, found damaged files: compare again") from error
    points, normals, colours, deviation = arrays
    up = np.array([0.0, 0.0, 1.0])
    viewed = DeviationCloud(
        points.astype(np.float64),
        normals.astype(np.float64),
        colours,
        (),
        None,
        up,
        unit,
        "room",
        deviation=deviation[:, 0].astype(np.float64),
        tolerance=tolerance or None,
        has_walls=False,
    )
    return viewed, verdict
