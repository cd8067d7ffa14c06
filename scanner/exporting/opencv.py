"""The calibration as OpenCV's FileStorage (YAML), with matrices for its functions."""

from pathlib import Path

import cv2
import numpy as np

from calib.geometry import Calibration
from scanner.exporting.covariance import PARAMETERS, ExportedCovariance, covariance_of_result
from scanner.exporting.formats import ExportRequest
from scanner.io import new_file
from scanner.quantities import unit_name
from scanner.results import read_calibration_of

_EXPLANATION = """Pixel centres are at integer coordinates; x right, y down, z forward.
X_projector = R X_camera + T: camera and projector are the first and the second camera of stereoRectify.
Distortion: k1 k2 p1 p2 k3. Covariance, if it is known: of 'covariance_parameters'; rotation is a small rotation vector
w in radians, by which R becomes exp([w]x) R. T, and all that is computed with it, is in the unit that 'unit' names."""


def export(request: ExportRequest) -> list[str]:
    """Write both devices. Raises InputError and OSError."""
    calibration = read_calibration_of(request.result)
    covariance = covariance_of_result(request.result, calibration)
    with new_file(request.out, overwrite=request.overwrite) as path:
        write_opencv(path, calibration, covariance)
    joint = "" if covariance is None else ", with their covariance"
    return [f"Both devices' matrices and distortion, R, and T in {unit_name(calibration.unit)}{joint}"]


def write_opencv(path: Path, calibration: Calibration, covariance: ExportedCovariance | None) -> None:
    """Write sizes, matrices and distortion of both devices, R, T, the unit, and the covariance if there is one.

    Raises OSError.
    """
    storage = cv2.FileStorage(
        ".yaml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML, "UTF-8"
    )
    storage.writeComment(_EXPLANATION)
    for name, device in (("camera", calibration.camera), ("projector", calibration.projector)):
        storage.write(f"{name}_width", int(device.width))
        storage.write(f"{name}_height", int(device.height))
        storage.write(f"{name}_matrix", device.matrix)
        storage.write(f"{name}_distortion", np.array([device.distortion], np.float64))
    storage.write("R", np.ascontiguousarray(calibration.pose.rotation))
    storage.write("T", calibration.pose.translation[:, None].copy())
    storage.write("unit", calibration.unit)
    if covariance is not None:
        storage.startWriteStruct("covariance_parameters", cv2.FileNode_SEQ)
        for name in PARAMETERS:
            storage.write("", name)
        storage.endWriteStruct()
        storage.write("covariance", covariance.values)
    path.write_text(storage.releaseAndGetString(), encoding="utf-8")
