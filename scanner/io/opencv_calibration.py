"""Calibrations of other programs: files of OpenCV's FileStorage, with the results of stereoCalibrate.

OpenCV's convention is this program's: X_second = R X_first + T, pixel centres at integer coordinates, k1 k2 p1 p2 k3.
The first device is the camera, the second the projector. Its YAML begins with a directive that YAML 1.1 refuses.
"""

import re
from typing import Any
from xml.etree import ElementTree

import numpy as np

from calib.numerics import Floats
from scanner.errors import InputError
from scanner.io.yaml_text import parse_mapping

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
