"""The cloud of a network as something to look at, with all its devices."""

from pathlib import Path

import numpy as np

from calib.geometry import Calibration
from scanner.cleaning import read_cleaned
from scanner.errors import InputError
from scanner.io import StoredDevice, read_network
from scanner.measuring import NetworkPoints, has_matches
from scanner.results import CAPTURES_FOLDER, NETWORK_CLOUD_FILE, NETWORK_FILE
from scanner.viewing.result import PlacedRig, ViewedCloud
from scanner.viewing.white_picture import read_white_picture


def network_cloud(folder: Path) -> ViewedCloud:
    """Read it, in the frame of the first device. Raises InputError if a file is missing or damaged."""
    cloud, network = read_cleaned(folder, own_axes=True).cloud(), read_network(folder / NETWORK_FILE)
    if not len(cloud):
        raise InputError(f"{folder / NETWORK_CLOUD_FILE}: the cloud is empty")
    cameras, projectors = (
        [device for device in network.devices if device.kind == kind] for kind in ("camera", "projector")
    )
    if not (cameras and projectors):
        raise InputError(f"{folder / NETWORK_FILE}: expected a camera and a projector or more")
    # Every device once, or more often where there are more of the other kind.
    rigs = tuple(
        _rig(cameras[number % len(cameras)], projectors[number % len(projectors)], network.unit, folder)
        for number in range(max(len(cameras), len(projectors)))
    )
    up = np.array([0.0, -1.0, 0.0])
    scans = NetworkPoints.read(folder) if has_matches(folder) else None
    return ViewedCloud(cloud.points, cloud.normals, cloud.colours, rigs, None, up, network.unit, "camera", scans=scans)


def _rig(camera: StoredDevice, projector: StoredDevice, unit: str, folder: Path) -> PlacedRig:
    to_projector = projector.place.inverse() @ camera.place
    calibration = Calibration(camera.intrinsics, projector.intrinsics, to_projector, unit)
    picture = read_white_picture(folder / CAPTURES_FOLDER / f"{camera.name}-{projector.name}")
    return PlacedRig(calibration, camera.place, picture, (camera.name, projector.name))
