"""How a rig's calibration changed over time: a file beside it, to which every update appends an entry.

`calibration.log.yaml` of `calibration.yaml` is a list, oldest first: the date, what was found, the values in use since
then with their standard deviations, and the file that keeps the calibration before.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from pydantic import AwareDatetime, Field, TypeAdapter, ValidationError

from calib.geometry import Calibration, Intrinsics, rotation_vector
from calib.numerics import Floats
from scanner.errors import InputError
from scanner.io import Entry, Number, flow_yaml, parse_yaml, read_text


@dataclass(frozen=True)
class LoggedParameter:
    """A parameter of a rig, with one to three numbers."""

    name: str
    """In the file."""
    label: str
    """For people."""
    unit: str
    """Of its differences: %, px or °."""
    axes: tuple[str, ...]
    """Names of its numbers; of the baseline's direction, that within the plane of x and y, and towards z."""


LOGGED = (
    LoggedParameter("camera_focal_px", "camera: focal length", "%", ("",)),
    LoggedParameter("camera_principal_point_px", "camera: principal point", "px", ("x", "y")),
    LoggedParameter("projector_focal_px", "projector: focal length", "%", ("",)),
    LoggedParameter("projector_principal_point_px", "projector: principal point", "px", ("x", "y")),
    LoggedParameter("rotation_deg", "rotation", "°", ("x", "y", "z")),
    LoggedParameter("direction_deg", "direction of the baseline", "°", ("xy", "z")),
)


class LogEntry(Entry):
    """A calibration since a date."""

    date: AwareDatetime
    holds: bool = True
    """Whether the calibration before it held."""
    change: str = ""
    """What was found, in a sentence."""
    captures: list[str] = Field(default_factory=list)
    """What it was estimated from."""
    kept: str = ""
    """Name of the file with the calibration before."""
    values: dict[str, list[Number]]
    """Numbers by the names of `LOGGED`."""
    sigmas: dict[str, list[Number]] = Field(default_factory=dict)
    """Standard deviations of the values, those that are known."""


def log_of(calibration: Path) -> Path:
    """The log of a calibration file, whether it is there or not."""
    return calibration.with_name(f"{calibration.stem}.log.yaml")


def read_log(path: Path) -> list[LogEntry]:
    """All entries, oldest first; none without a file. Raises InputError."""
    if not path.exists():
        return []
    try:
        return TypeAdapter(list[LogEntry]).validate_python(parse_yaml(read_text(path), str(path)))
    except ValidationError as error:
        details = error.errors(include_url=False)[0]
        where = ".".join(map(str, details["loc"]))
        raise InputError(
            f"{path}: expected a list of calibrations over time, as scan check --update writes it; {where or 'it'}: "
            f"{details['msg']}. Move the file away to begin a new log"
        ) from error


def entry_for(
    calibration: Calibration,
    date: datetime,
    *,
    holds: bool = True,
    change: str = "",
    captures: Sequence[str] = (),
    kept: str = "",
) -> LogEntry:
    """The entry of a calibration."""
    sigma = calibration.sigma
    direction = calibration.pose.in_baselines.translation
    values: dict[str, list[float]] = {
        "camera_focal_px": _focal(calibration.camera),
        "camera_principal_point_px": [*calibration.camera.principal_point_px],
        "projector_focal_px": _focal(calibration.projector),
        "projector_principal_point_px": [*calibration.projector.principal_point_px],
        "rotation_deg": np.degrees(rotation_vector(calibration.pose.rotation)).tolist(),
        "direction_deg": np.degrees([np.arctan2(direction[1], direction[0]), np.arcsin(direction[2])]).tolist(),
    }
    known = {
        "camera_focal_px": sigma.camera.focal_px and sigma.camera.focal_px[:1],
        "camera_principal_point_px": sigma.camera.principal_point_px,
        "projector_focal_px": sigma.projector.focal_px and sigma.projector.focal_px[:1],
        "projector_principal_point_px": sigma.projector.principal_point_px,
        "rotation_deg": sigma.rotation_deg,
        "direction_deg": sigma.translation_direction_deg and (sigma.translation_direction_deg / np.sqrt(2),) * 2,
    }
    return LogEntry(
        date=date.astimezone(UTC),
        holds=holds,
        change=change,
        captures=[*captures],
        kept=kept,
        values={name: [float(number) for number in numbers] for name, numbers in values.items()},
        sigmas={name: [float(number) for number in numbers] for name, numbers in known.items() if numbers},
    )


def log_text(entries: Sequence[LogEntry]) -> str:
    """The text of a log with these entries."""
    return "".join(_entry_text(entry) for entry in entries)


def _entry_text(entry: LogEntry) -> str:
    fields = entry.model_dump(mode="json")
    return "".join(f"{'  ' if n else '- '}{key}: {flow_yaml(value)}\n" for n, (key, value) in enumerate(fields.items()))


def differences(entries: Sequence[LogEntry], parameter: LoggedParameter) -> Iterator[tuple[Floats, Floats]]:
    """For each number of a parameter how it differs from the first entry's, and its sigma, (N,) each, in its unit.

    Sigmas are 0 where unknown. A parameter that an entry lacks has NaN there.
    """
    first = entries[0].values.get(parameter.name, [])
    for k in range(min(len(first), len(parameter.axes))):
        values = np.array([_number(entry.values, parameter.name, k, np.nan) for entry in entries])
        sigmas = np.array([_number(entry.sigmas, parameter.name, k, 0.0) for entry in entries])
        factor = 100 / first[k] if parameter.unit == "%" and first[k] else 1.0
        off = values - first[k]
        if parameter.unit == "°":
            off = (off + 180) % 360 - 180
        yield factor * off, abs(factor) * sigmas


def _number(by_name: dict[str, list[float]], name: str, k: int, missing: float) -> float:
    numbers = by_name.get(name, [])
    return numbers[k] if k < len(numbers) else missing


def _focal(device: Intrinsics) -> list[float]:
    return [float(np.mean(device.focal_px))]
