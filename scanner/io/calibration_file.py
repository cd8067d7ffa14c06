"""`calibration.yaml`, and `truth.yaml` of simulated rigs: one format, read and written."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
import yaml
from pydantic import Field

from calib.geometry import Calibration, DeviceSigmas, Intrinsics, Sigmas
from scanner.errors import InputError
from scanner.io.validation import Entry, Number, Pair, Whole, validate
from scanner.io.yaml_text import flow_yaml, read_yaml

_Positive = Annotated[Number, Field(gt=0)]
_Vector = tuple[Number, Number, Number]
_Sigma = Annotated[Number, Field(ge=0)]
_OneOr2 = _Sigma | tuple[_Sigma, _Sigma]
_OneOr3 = _Sigma | tuple[_Sigma, _Sigma, _Sigma]
_UpTo5 = Annotated[tuple[_Sigma, ...], Field(max_length=5)]


class _DeviceEntry(Entry):
    width: Whole = Field(ge=1)
    height: Whole = Field(ge=1)
    focal_px: tuple[_Positive, _Positive]
    principal_point_px: Pair
    distortion: list[Number] = Field(default=[], max_length=5)

    def intrinsics(self) -> Intrinsics:
        k1, k2, p1, p2, k3 = (*self.distortion, *[0.0] * (5 - len(self.distortion)))
        return Intrinsics(self.width, self.height, self.focal_px, self.principal_point_px, (k1, k2, p1, p2, k3))


class _SigmaEntry(Entry):
    """The keys of `sigma`. One number stands for all that a key has."""

    camera_focal_px: _OneOr2 | None = None
    camera_principal_point_px: _OneOr2 | None = None
    camera_distortion: _Sigma | _UpTo5 | None = None
    projector_focal_px: _OneOr2 | None = None
    projector_principal_point_px: _OneOr2 | None = None
    projector_distortion: _Sigma | _UpTo5 | None = None
    rotation_deg: _OneOr3 | None = None
    translation_direction_deg: _Sigma | None = None
    corner_angles_deg: _OneOr3 | None = None

    def sigmas(self) -> Sigmas:
        return Sigmas(
            DeviceSigmas(
                _pair(self.camera_focal_px), _pair(self.camera_principal_point_px), _tuple(self.camera_distortion)
            ),
            DeviceSigmas(
                _pair(self.projector_focal_px),
                _pair(self.projector_principal_point_px),
                _tuple(self.projector_distortion),
            ),
            _triple(self.rotation_deg),
            self.translation_direction_deg,
            _triple(self.corner_angles_deg),
        )

    @classmethod
    def of(cls, sigmas: Sigmas) -> Self:
        camera, projector = sigmas.camera, sigmas.projector
        return cls(
            camera_focal_px=_one_if_alike(camera.focal_px),
            camera_principal_point_px=camera.principal_point_px,
            camera_distortion=camera.distortion,
            projector_focal_px=_one_if_alike(projector.focal_px),
            projector_principal_point_px=projector.principal_point_px,
            projector_distortion=projector.distortion,
            rotation_deg=sigmas.rotation_deg,
            translation_direction_deg=sigmas.translation_direction_deg,
            corner_angles_deg=sigmas.corner_angles_deg,
        )


def _pair(value: _OneOr2 | None) -> tuple[float, float] | None:
    return (value, value) if isinstance(value, float) else value


def _triple(value: _OneOr3 | None) -> tuple[float, float, float] | None:
    return (value, value, value) if isinstance(value, float) else value


def _tuple(value: float | tuple[float, ...] | None) -> tuple[float, ...] | None:
    return (value,) if isinstance(value, float) else value


def _one_if_alike(value: tuple[float, float] | None) -> _OneOr2 | None:
    return value[0] if value and value[0] == value[1] else value


class _CalibrationEntry(Entry):
    camera: _DeviceEntry
    projector: _DeviceEntry
    rotation: tuple[_Vector, _Vector, _Vector]
    translation: _Vector
    unit: str = Field(min_length=1, max_length=20)
    sigma: _SigmaEntry = Field(default_factory=_SigmaEntry)

    def calibration(self) -> Calibration:
        return Calibration(
            self.camera.intrinsics(),
            self.projector.intrinsics(),
            np.array(self.rotation),
            np.array(self.translation),
            self.unit,
            self.sigma.sigmas(),
        )


def read_calibration(path: Path) -> Calibration:
    """Read a calibration; keys beyond the format are ignored, a distortion of fewer than five terms ends in zeros.

    Raises InputError for a missing file, a missing or wrong key, or a rotation that is none.
    """
    entry = validate(_CalibrationEntry, read_yaml(path), str(path))
    try:
        return entry.calibration()
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error


def write_calibration(path: Path, calibration: Calibration, more: Mapping[str, Any] | None = None) -> None:
    """Write a calibration, and `more` keys for those who know them. Numbers read back the same. Raises OSError."""
    lines = [
        f"camera: {flow_yaml(_device_to_dict(calibration.camera))}",
        f"projector: {flow_yaml(_device_to_dict(calibration.projector))}",
        "rotation:",
        *(f"  - {flow_yaml(row)}" for row in calibration.rotation.tolist()),
        f"translation: {flow_yaml(calibration.translation.tolist())}",
        f"unit: {flow_yaml(calibration.unit)}",
    ]
    if sigma := _SigmaEntry.of(calibration.sigma).model_dump(mode="json", exclude_none=True):
        lines.append(f"sigma: {flow_yaml(sigma)}")
    if more:
        lines.append(
            # Lists of plain values on one line each, the rest in blocks.
            yaml.safe_dump(dict(more), default_flow_style=None, allow_unicode=True, sort_keys=False, width=math.inf)
        )
    path.write_text("\n".join(lines).rstrip("\n") + "\n", encoding="utf-8")


def _device_to_dict(device: Intrinsics) -> dict[str, object]:
    return {
        "width": int(device.width),
        "height": int(device.height),
        "focal_px": [float(number) for number in device.focal_px],
        "principal_point_px": [float(number) for number in device.principal_point_px],
        "distortion": [float(number) for number in device.distortion],
    }
