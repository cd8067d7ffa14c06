"""The calibration as OpenCV's FileStorage (YAML): matrices that its functions take as they are."""

from pathlib import Path

import cv2
import numpy as np

from calib.geometry import Calibration

_EXPLANATION = """Pixel centres are at integer coordinates; x right, y down, z forward.
X_projector = R X_camera + T: camera and projector are the first and the second camera of stereoRectify.
Distortion: k1 k2 p1 p2 k3. T, and all that is computed with it, is in the unit that 'unit' names."""


def write_opencv(path: Path, calibration: Calibration) -> None:
    """Write sizes, matrices and distortion of both devices, R, T and the unit. Raises OSError."""
    storage = cv2.FileStorage(
        ".yaml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML, "UTF-8"
    )
    storage.writeComment(_EXPLANATION)
    for name, device in (("camera", calibration.camera), ("projector", calibration.projector)):
        storage.write(f"{name}_width", int(device.width))
        storage.write(f"{name}_height", int(device.height))
        storage.write(f"{name}_matrix", device.matrix)
        storage.write(f"{name}_distortion", np.array([device.distortion], np.float64))
    storage.write("R", np.ascontiguousarray(calibration.rotation))
    storage.write("T", calibration.translation[:, None].copy())
    storage.write("unit", calibration.unit)
    path.write_text(storage.releaseAndGetString(), encoding="utf-8")
