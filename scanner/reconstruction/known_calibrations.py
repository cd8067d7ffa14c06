"""Results that are a calibration without captures, such as of boards: they are combined with captures."""

from collections.abc import Sequence
from pathlib import Path

from calib.geometry import Size
from calib.self_calibration import KnownCalibration
from scanner.errors import InputError
from scanner.io import MATCHES_FILE, read_calibration
from scanner.results import CALIBRATION_FILE, read_uncertainty

_YAML = (".yaml", ".yml")


def is_calibration(path: Path) -> bool:
    """Whether a path is a calibration file, or a result that has a calibration and no matches."""
    if path.is_dir():
        return (path / CALIBRATION_FILE).is_file() and not (path / MATCHES_FILE).exists()
    return path.suffix.lower() in _YAML


def read_known(paths: Sequence[Path], camera_size: Size, projector_size: Size) -> KnownCalibration | None:
    """The one calibration among these paths; None if all are captures.

    Raises InputError if there are two, or if it is of another rig, or has no covariance.
    """
    given = [path for path in paths if is_calibration(path)]
    if not given:
        return None
    if len(given) > 1:
        raise InputError(
            f"{', '.join(map(str, given))}: expected at most one calibration to join with captures; give all captures "
            "of boards to one scan board"
        )
    (path,) = given
    return _read(path / CALIBRATION_FILE if path.is_dir() else path, camera_size, projector_size)


def _read(file: Path, camera_size: Size, projector_size: Size) -> KnownCalibration:
    calibration = read_calibration(file)
    for name, device, expected in (
        ("camera", calibration.camera, camera_size),
        ("projector", calibration.projector, projector_size),
    ):
        if device.size != expected:
            raise InputError(
                f"{file}: its {name} is {device.size}, but {expected} is expected: what is calibrated together comes "
                "from one unchanged rig"
            )
    uncertainty = read_uncertainty(file, calibration)
    if uncertainty is None:
        raise InputError(
            f"{file}: has no covariance, without which it cannot be weighed against captures: make it with scan board"
        )
    return KnownCalibration(calibration, uncertainty)
