"""`calibration.yaml`, and `truth.yaml` of simulated rigs: one format, read and written.

Calibrations of other programs: files of OpenCV's FileStorage, with the results of stereoCalibrate.

OpenCV's convention is this program's: X_second = R X_first + T, pixel centres at integer coordinates, k1 k2 p1 p2 k3.
The first device is the camera, the second the projector. Its YAML begins with a directive that YAML 1.1 refuses.
"""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any
from xml.etree import ElementTree

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from calib.geometry import Calibration, DeviceSigmas, Intrinsics, Pose, Sigmas
from calib.numerics import Floats
from scanner.errors import InputError
from scanner.io.given_file import LONGEST_SIDE_PX, refuse_more_pixels
from scanner.io.validation import Entry, Number, Whole, validate
from scanner.io.yaml_text import block_yaml, flow_yaml, parse_mapping, read_text

_DIRECTIVE, _TAG = re.compile(r"\A\s*%YAML[: ]1\.[0-9]\s*"), re.compile(r"!!opencv-matrix\b")
_XML = re.compile(r"\A\s*(<\?xml[^>]*\?>\s*)?<opencv_storage\b")  # with no place for a DTD and its entities
# Those of `scan export`, of stereoCalibrate's arguments, of its documentation's examples, of Moreno and Taubin's
# scanner, and of SLStudio.
_MATRICES = (
    ("camera_matrix", "cameraMatrix1", "M1", "K1", "cam_K", "Kc"),
    ("projector_matrix", "cameraMatrix2", "M2", "K2", "proj_K", "Kp"),
)
_DISTORTIONS = (
    ("camera_distortion", "distCoeffs1", "D1", "cam_kc", "kc"),
    ("projector_distortion", "distCoeffs2", "D2", "proj_kc", "kp"),
)
_SIZES = (
    (("camera_width", "frameWidth"), ("camera_height", "frameHeight")),
    (("projector_width", "screenResX"), ("projector_height", "screenResY")),
)
_ROTATION, _TRANSLATION = ("R", "Rp", "rotation"), ("T", "Tp", "translation")
_TERMS, _NO_SKEW = 5, 1e-6
# Beyond any device and unit of length, but small enough that products are finite.
_LARGEST, _SMALLEST = 1e9, 1e-9
_Focal = Annotated[Number, Field(ge=0.1, le=1e7)]
_Pixel = Annotated[Number, Field(ge=-1e7, le=1e7)]
_Term = Annotated[Number, Field(ge=-1e4, le=1e4)]
_Length = Annotated[Number, Field(ge=-_LARGEST, le=_LARGEST)]
_Cosine = Annotated[Number, Field(ge=-2, le=2)]
_Sigma = Annotated[Number, Field(ge=0, le=1e12)]

_Row = tuple[_Cosine, _Cosine, _Cosine]


def is_opencv(text: str) -> bool:
    """Whether a text is a file of OpenCV's FileStorage, YAML or XML."""
    return bool(_DIRECTIVE.match(text) or _XML.match(text) or _TAG.search(text))


def parse_opencv(text: str, source: str) -> dict[str, Any]:
    """The keys of calibration.yaml for such a text, which comes from `source`. Raises InputError.

    Lengths are in baselines where it has no key `unit`: OpenCV leaves that to whoever measured the board.
    """
    storage = _from_xml(text, source) if _XML.match(text) else _from_yaml(text, source)
    devices = [_device(storage, number, source) for number in (0, 1)]
    translation = _matrix(storage, _TRANSLATION, (3,), source)
    unit = storage.get("unit")
    if unit is None:
        translation = translation / max(float(np.linalg.norm(translation)), 1e-300)
    return {
        "camera": devices[0],
        "projector": devices[1],
        "rotation": _matrix(storage, _ROTATION, (3, 3), source).tolist(),
        "translation": translation.tolist(),
        "unit": "baseline" if unit is None else unit,
    }


def _from_yaml(text: str, source: str) -> dict[str, Any]:
    return parse_mapping(_TAG.sub("", _DIRECTIVE.sub("", text)), source)


def _from_xml(text: str, source: str) -> dict[str, Any]:
    try:
        root = ElementTree.fromstring(text.strip())
    except ElementTree.ParseError as error:
        raise InputError(f"{source}: not valid XML: {error}") from error
    return {
        node.tag: {"data": (node.findtext("data") or "").split()} if node.find("data") is not None else node.text
        for node in root
    }


def _device(storage: dict[str, Any], number: int, source: str) -> dict[str, Any]:
    matrix = _matrix(storage, _MATRICES[number], (3, 3), source)
    name, _ = _found(storage, _MATRICES[number], source)
    fx, fy = float(matrix[0, 0]), float(matrix[1, 1])
    if abs(matrix[0, 1]) > _NO_SKEW * abs(fx):
        raise InputError(f"{source}: {name} has a skew of {matrix[0, 1]:g}: expected pixels with a right angle")
    name, value = _found(storage, _DISTORTIONS[number], source)
    terms = _numbers(value, name, source)
    if np.any(terms[_TERMS:] != 0):
        raise InputError(
            f"{source}: {name} has {len(terms)} terms: expected k1, k2, p1, p2, k3; calibrate without a rational or "
            "a prism model"
        )
    return {
        **{key: _whole(storage, names, source) for key, names in zip(("width", "height"), _SIZES[number], strict=True)},
        "focal_px": [fx, fy],
        "principal_point_px": [float(matrix[0, 2]), float(matrix[1, 2])],
        "distortion": terms[:_TERMS].tolist(),
    }


def _found(storage: dict[str, Any], names: tuple[str, ...], source: str) -> tuple[str, Any]:
    """The name that a file has of several, with its value."""
    for name in names:
        if storage.get(name) is not None:
            return name, storage[name]
    raise InputError(
        f"{source}: is a file of OpenCV without {names[0]} (or {', '.join(names[1:])}): expected the results of "
        "stereoCalibrate for camera and projector, with their sizes"
    )


def _matrix(storage: dict[str, Any], names: tuple[str, ...], shape: tuple[int, ...], source: str) -> Floats:
    name, value = _found(storage, names, source)
    numbers = _numbers(value, name, source)
    if len(numbers) != int(np.prod(shape)):
        raise InputError(f"{source}: {name} must have {' × '.join(map(str, shape))} numbers, found {len(numbers)}")
    return numbers.reshape(shape)


def _numbers(value: object, name: str, source: str) -> Floats:
    data = value.get("data") if isinstance(value, dict) else value
    try:
        numbers = np.array(data, np.float64).ravel()
    except (TypeError, ValueError):
        numbers = np.array([np.nan])
    if not np.isfinite(numbers).all():
        raise InputError(f"{source}: {name} must be a matrix of numbers")
    return numbers


def _whole(storage: dict[str, Any], names: tuple[str, ...], source: str) -> int:
    name, value = next(((name, storage[name]) for name in names if storage.get(name) is not None), (names[0], None))
    if value is None:
        raise InputError(f"{source}: says no size: add the line {name}, as in {name}: 1280")
    try:
        return int(str(value).strip())
    except ValueError:
        raise InputError(f"{source}: {name} must be a whole number of pixels") from None


def _repeated(count: int) -> BeforeValidator:
    """Expand a single number to `count` copies."""
    return BeforeValidator(lambda value: value if isinstance(value, list) else [value] * count)


_Two = Annotated[tuple[_Sigma, _Sigma], _repeated(2)]
_Three = Annotated[tuple[_Sigma, _Sigma, _Sigma], _repeated(3)]
_Terms = Annotated[tuple[_Sigma, ...], Field(max_length=5), _repeated(1)]


class DeviceEntry(Entry):
    """A device's intrinsics."""

    width: Whole = Field(ge=1, le=LONGEST_SIDE_PX)
    height: Whole = Field(ge=1, le=LONGEST_SIDE_PX)
    focal_px: tuple[_Focal, _Focal]
    principal_point_px: tuple[_Pixel, _Pixel]
    distortion: list[_Term] = Field(default=[], max_length=5)

    @model_validator(mode="after")
    def _has_a_size_that_is_read(self) -> "DeviceEntry":
        refuse_more_pixels(self.width, self.height)
        return self

    def intrinsics(self) -> Intrinsics:
        """Terms that are missing are zero."""
        k1, k2, p1, p2, k3 = (*self.distortion, *[0.0] * (5 - len(self.distortion)))
        return Intrinsics(self.width, self.height, self.focal_px, self.principal_point_px, (k1, k2, p1, p2, k3))


class _SigmaEntry(Entry):
    camera_focal_px: _Two | None = None
    camera_principal_point_px: _Two | None = None
    camera_distortion: _Terms | None = None
    projector_focal_px: _Two | None = None
    projector_principal_point_px: _Two | None = None
    projector_distortion: _Terms | None = None
    rotation_deg: _Three | None = None
    translation_direction_deg: _Sigma | None = None
    corner_angles_deg: _Three | None = None
    known_baseline: _Sigma | None = None
    known_camera_to_corner: _Sigma | None = None

    def sigmas(self) -> Sigmas:
        return Sigmas(
            DeviceSigmas(self.camera_focal_px, self.camera_principal_point_px, self.camera_distortion),
            DeviceSigmas(self.projector_focal_px, self.projector_principal_point_px, self.projector_distortion),
            self.rotation_deg,
            self.translation_direction_deg,
            self.corner_angles_deg,
            self.known_baseline,
            self.known_camera_to_corner,
        )


class _CalibrationEntry(Entry):
    camera: DeviceEntry
    projector: DeviceEntry
    rotation: tuple[_Row, _Row, _Row]
    translation: tuple[_Length, _Length, _Length]
    unit: str = Field(min_length=1, max_length=20, pattern=r"^[^\[\]\n\t]+$")  # brackets are markup in a terminal
    sigma: _SigmaEntry = Field(default_factory=_SigmaEntry)

    def calibration(self) -> Calibration:
        return Calibration(
            self.camera.intrinsics(),
            self.projector.intrinsics(),
            Pose(np.array(self.rotation), np.array(self.translation)),
            self.unit,
            self.sigma.sigmas(),
        )


def read_calibration(path: Path) -> Calibration:
    """Read a calibration; unknown keys are ignored, a distortion of fewer than five terms is padded with zeros.

    It may also be a file of OpenCV's FileStorage. Raises InputError for a missing file, a missing or wrong key, or an
    invalid rotation.
    """
    return _calibration(read_calibration_keys(path), str(path))


def read_calibration_keys(path: Path) -> dict[str, Any]:
    """All keys of a calibration file; of one of OpenCV, as this program would write them. Raises InputError."""
    return _keys(read_text(path), str(path))


def parse_calibration(text: str, source: str) -> Calibration:
    """Parse a calibration like `read_calibration`, from a text that comes from `source`. Raises InputError."""
    return _calibration(_keys(text, source), source)


def _keys(text: str, source: str) -> dict[str, Any]:
    return parse_opencv(text, source) if is_opencv(text) else parse_mapping(text, source)


def _calibration(mapping: dict[str, Any], source: str) -> Calibration:
    entry = validate(_CalibrationEntry, mapping, source)
    if math.hypot(*entry.translation) < _SMALLEST:
        raise InputError(f"{source}: translation must not be zero: camera and projector would be in one place")
    try:
        return entry.calibration()
    except ValueError as error:
        raise InputError(f"{source}: {error}") from error


def write_calibration(path: Path, calibration: Calibration, more: Mapping[str, Any] | None = None) -> None:
    """Write a calibration and `more` keys. Numbers read back the same. Raises OSError."""
    lines = [
        f"camera: {flow_yaml(_device_to_dict(calibration.camera))}",
        f"projector: {flow_yaml(_device_to_dict(calibration.projector))}",
        "rotation:",
        *(f"  - {flow_yaml(row)}" for row in calibration.pose.rotation.tolist()),
        f"translation: {flow_yaml(calibration.pose.translation.tolist())}",
        f"unit: {flow_yaml(calibration.unit)}",
    ]
    if sigma := _sigma_to_dict(calibration.sigma):
        lines.append(f"sigma: {flow_yaml(sigma)}")
    if more:
        lines.append(block_yaml(more))
    path.write_text("\n".join(lines).rstrip("\n") + "\n", encoding="utf-8")


def _device_to_dict(device: Intrinsics) -> dict[str, object]:
    return {
        "width": int(device.width),
        "height": int(device.height),
        "focal_px": [float(number) for number in device.focal_px],
        "principal_point_px": [float(number) for number in device.principal_point_px],
        "distortion": [float(number) for number in device.distortion],
    }


def _sigma_to_dict(sigma: Sigmas) -> dict[str, object]:
    """Return the sigmas by the keys of `_SigmaEntry`, in its order, without unknown ones."""
    camera, projector = sigma.camera, sigma.projector
    values = [
        *(_one_if_alike(camera.focal_px), camera.principal_point_px, camera.distortion),
        *(_one_if_alike(projector.focal_px), projector.principal_point_px, projector.distortion),
        *(sigma.rotation_deg, sigma.translation_direction_deg, sigma.corner_angles_deg),
        *(sigma.known_baseline, sigma.known_camera_to_corner),
    ]
    rows = [list(value) if isinstance(value, tuple) else value for value in values]
    return {key: value for key, value in zip(_SigmaEntry.model_fields, rows, strict=True) if value is not None}


def _one_if_alike(pair: tuple[float, float] | None) -> float | tuple[float, float] | None:
    return pair[0] if pair and pair[0] == pair[1] else pair
