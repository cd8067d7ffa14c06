"""The calibration as two of mrcal's camera models, with the covariance beside them.

A `.cameramodel` is a Python dictionary of `lens_model`, `intrinsics` (f_x, f_y, c_x, c_y and the lens terms),
`extrinsics` (rt_cam_ref: a Rodrigues vector and a translation that lead from the reference frame to the camera's) and
`imagersize`. See https://mrcal.secretsauce.net/cameramodels.html. The reference is the scanner's camera. Pixel centres
are at integers and distances in the result's unit, as here. Covariances have no place in that format.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

from calib.geometry import IDENTITY, Calibration, Intrinsics, Pose, rotation_vector
from scanner.exporting.covariance import COVARIANCE_FILE, ExportedCovariance, covariance_of_result
from scanner.exporting.formats import ExportRequest
from scanner.io import new_files, refuse_existing
from scanner.quantities import unit_name
from scanner.results import read_calibration_of

CAMERA_MODEL, PROJECTOR_MODEL = "camera.cameramodel", "projector.cameramodel"
_LENS_MODEL = "LENSMODEL_OPENCV5"  # k1 k2 p1 p2 k3


def export(request: ExportRequest) -> list[str]:
    """Write both devices. Raises InputError and OSError."""
    calibration = read_calibration_of(request.result)
    covariance = covariance_of_result(request.result, calibration)
    write_mrcal(request.out, calibration, covariance, overwrite=request.overwrite)
    joint = "" if covariance is None else f", their joint covariance in {COVARIANCE_FILE}"
    return [f"Both devices as camera models in {unit_name(calibration.unit)}{joint}"]


def write_mrcal(
    folder: Path, calibration: Calibration, covariance: ExportedCovariance | None, *, overwrite: bool
) -> None:
    """Write camera, projector, and the covariance if there is one. Raises InputError if a file exists and may not be
    replaced, OSError.
    """
    contents: dict[str, Iterable[str]] = {
        CAMERA_MODEL: _model("camera", calibration.camera, IDENTITY, calibration.unit),
        PROJECTOR_MODEL: _model("projector", calibration.projector, calibration.pose, calibration.unit),
    }
    if covariance is not None:
        contents[COVARIANCE_FILE] = covariance.lines
    for name in {*contents, COVARIANCE_FILE}:
        refuse_existing(folder / name, overwrite=overwrite)
    with new_files(folder, tuple(contents), overwrite=overwrite) as paths:
        for path, lines in zip(paths, contents.values(), strict=True):
            path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    if covariance is None:
        (folder / COVARIANCE_FILE).unlink(missing_ok=True)  # of another calibration


def _model(name: str, device: Intrinsics, pose: Pose, unit: str) -> list[str]:
    """The dictionary; `pose` leads from the scanner's camera to the device."""
    intrinsics = [*device.focal_px, *device.principal_point_px, *device.distortion]
    extrinsics = [*rotation_vector(pose.rotation), *pose.translation]
    return [
        f"# The {name}; the reference frame is the scanner's camera, lengths are in {' '.join(unit.split())}",
        "{",
        f"    'lens_model':  '{_LENS_MODEL}',",
        "",
        "    # fx, fy, cx, cy, k1, k2, p1, p2, k3",
        f"    'intrinsics': {_numbers(intrinsics)},",
        "",
        "    # rt_cam_ref",
        f"    'extrinsics': {_numbers(extrinsics)},",
        "",
        f"    'imagersize': [{device.width}, {device.height}],",
        "}",
    ]


def _numbers(values: Sequence[float]) -> str:
    return f"[{', '.join(repr(float(value) + 0.0) for value in values)}]"  # no −0
