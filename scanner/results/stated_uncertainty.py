"""Uncertainties as files state them: the covariance of a calibration, the errors of the poses of captures or stations,
and the covariance of a network's devices with the known distance that gives its scale.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from calib.diagnostics import NOWHERE, Along, PoseErrors, Uncertainty
from calib.geometry import PER_POSE, Calibration, tangent_basis
from calib.networks import PER_NODE, PLACE, NetworkEstimate
from calib.numerics import Floats
from calib.refinement import ROTATION, SHARED, TRANSLATION, State, device_of
from scanner.errors import InputError
from scanner.io import Entry, Number, read_calibration_keys, read_yaml, validate
from scanner.results.verdict import Verdict, verdict_entries

_OF_DEVICE = ("log_focal", "principal_point_x_px", "principal_point_y_px", "k1", "k2", "p1", "p2", "k3")
COLUMNS = (
    *(f"{device}_{column}" for device in ("camera", "projector") for column in _OF_DEVICE),
    *(f"rotation_{axis}_rad" for axis in "xyz"),
    *(f"translation_{axis}" for axis in "xyz"),
)
# Files written before further lens terms existed lack these, which their calibrations fixed to zero.
_FURTHER = tuple(f"{device}_{term}" for device in ("camera", "projector") for term in ("p1", "p2", "k3"))

_LOG_FOCALS = [index for index, column in enumerate(COLUMNS) if column.endswith("log_focal")]
_MOST_LOG_SIGMA, _MOST_SIGMA = 5.0, 1e7  # a factor of 150 of a focal length; more pixels than any image has
_ANGLES = [index for index, column in enumerate(COLUMNS) if column.startswith(("rotation", "translation"))]
_ROUNDED, _NOTHING = 1e-6, 1e-9
_MOST_VARIANCE = 1e24  # squared units of a scene
_DIGITS = 8


class _AlongEntry(Entry):
    probability: list[Annotated[Number, Field(gt=0, le=1)]]
    steps: list[list[Number]]


class _CovarianceEntry(Entry):
    columns: list[str]
    match_px: Number = Field(gt=0)
    values: list[list[Number]]
    with_log_baseline: list[Number] = Field(default_factory=list)
    along: _AlongEntry | None = None


class _ConfidenceEntry(Entry):
    covariance: _CovarianceEntry | None = None


def confidence_entries(verdict: Verdict, uncertainty: Uncertainty | None) -> dict[str, Any]:
    """Keys for a calibration file; `uncertainty` None where a method knows none."""
    return verdict_entries(verdict) | ({} if uncertainty is None else covariance_entries(uncertainty))


def covariance_entries(uncertainty: Uncertainty) -> dict[str, Any]:
    """A key for a calibration file."""
    to_file = columns_of_file(uncertainty.state.pose.translation)
    covariance = {
        "columns": [*COLUMNS],
        "match_px": float(uncertainty.match_px),
        "values": (to_file @ uncertainty.covariance @ to_file.T).tolist(),
    }
    if uncertainty.with_log_baseline.any():
        covariance["with_log_baseline"] = (to_file @ uncertainty.with_log_baseline).tolist()
    along = uncertainty.along
    if len(along.probability):
        steps = (along.steps @ to_file.T).tolist()
        covariance["along"] = {"probability": along.probability.tolist(), "steps": steps}
    return {"covariance": covariance}


def read_uncertainty(path: Path, calibration: Calibration) -> Uncertainty | None:
    """The covariance in the file of a `calibration`; None where it says none. Raises InputError if it is malformed."""
    entry = validate(_ConfidenceEntry, read_calibration_keys(path), str(path)).covariance
    if entry is None:
        return None
    if tuple(entry.columns) == tuple(column for column in COLUMNS if column not in _FURTHER):
        entry = _with_further_terms(entry)
    if tuple(entry.columns) != COLUMNS:
        raise InputError(f"{path}: 'covariance.columns' must be {', '.join(COLUMNS)}, found {', '.join(entry.columns)}")
    if len(entry.values) != len(COLUMNS) or any(len(row) != len(COLUMNS) for row in entry.values):
        raise InputError(f"{path}: 'covariance.values' must be {len(COLUMNS)} rows of as many numbers")
    values = np.array(entry.values)
    if not _is_covariance(values):
        raise InputError(
            f"{path}: 'covariance.values' are no covariance: not symmetric, negative, or beyond any device"
        )
    camera, projector = device_of(calibration.camera), device_of(calibration.projector)
    state = State(camera, projector, calibration.pose.in_baselines)
    to_file = columns_of_file(state.pose.translation)
    # The columns of `to_file` are orthonormal.
    covariance = to_file.T @ values @ to_file
    along = _along(path, entry.along, to_file)
    with_log_baseline = _with_log_baseline(path, entry.with_log_baseline, np.diag(values), calibration) @ to_file
    return Uncertainty(state, covariance, None, entry.match_px, along, with_log_baseline)


def _with_further_terms(entry: _CovarianceEntry) -> _CovarianceEntry:
    """Fill missing columns of older files with zeros; entries of wrong length are unchanged."""

    def filled(numbers: list[float]) -> list[float]:
        if len(numbers) != len(entry.columns):
            return numbers
        stated = dict(zip(entry.columns, numbers, strict=True))
        return [stated.get(column, 0.0) for column in COLUMNS]

    if len(entry.values) != len(entry.columns):
        return entry
    rows = dict(zip(entry.columns, map(filled, entry.values), strict=True))
    along = entry.along and entry.along.model_copy(update={"steps": [filled(step) for step in entry.along.steps]})
    return entry.model_copy(
        update={
            "columns": [*COLUMNS],
            "values": [rows.get(column, [0.0] * len(COLUMNS)) for column in COLUMNS],
            "with_log_baseline": filled(entry.with_log_baseline),
            "along": along,
        }
    )


def _with_log_baseline(path: Path, stated: list[float], variance: Floats, calibration: Calibration) -> Floats:
    """Return the covariance in the file's columns, (22,). Raises InputError if it is malformed."""
    if not stated:
        return np.zeros(len(COLUMNS))
    if len(stated) != len(COLUMNS):
        raise InputError(f"{path}: 'covariance.with_log_baseline' must be {len(COLUMNS)} numbers, found {len(stated)}")
    covariance = np.array(stated)
    sigma = (calibration.sigma.known_baseline or 0.0) / calibration.baseline
    if np.any(np.abs(covariance) > (1 + _ROUNDED) * sigma * np.sqrt(variance.clip(0)) + _NOTHING):
        raise InputError(
            f"{path}: 'covariance.with_log_baseline' is more than the columns' and the baseline's own sigmas allow"
        )
    return covariance


def _is_covariance(values: Floats) -> bool:
    """Whether a matrix (n, n) in the file's columns can be one, but for rounding."""
    sigma = np.sqrt(np.clip(np.diag(values), 0.0, None))
    if np.any(np.diag(values) < 0) or sigma.max() > _MOST_SIGMA or sigma[_LOG_FOCALS].max() > _MOST_LOG_SIGMA:
        return False
    scale = np.where(sigma > _NOTHING * sigma.max(), sigma, 1.0)  # rounding errors of fixed parameters
    correlation = values / np.outer(scale, scale)
    if not np.allclose(correlation, correlation.T, atol=_ROUNDED):
        return False
    return bool(np.linalg.eigvalsh(correlation)[0] > -len(values) * _ROUNDED)


def _along(path: Path, entry: _AlongEntry | None, to_file: Floats) -> Along:
    """Raises InputError if it is malformed."""
    if entry is None:
        return NOWHERE
    if len(entry.steps) != len(entry.probability) or any(len(step) != len(COLUMNS) for step in entry.steps):
        raise InputError(
            f"{path}: 'covariance.along' must have a row of {len(COLUMNS)} steps for each of its probabilities"
        )
    steps = np.array(entry.steps).reshape(-1, len(COLUMNS))
    most = np.full(len(COLUMNS), _MOST_SIGMA)
    most[_LOG_FOCALS], most[_ANGLES] = _MOST_LOG_SIGMA, np.pi  # both in radians; the direction is of unit length
    if np.any(np.abs(steps) > most):
        raise InputError(f"{path}: 'covariance.along.steps' are beyond any device")
    return Along(steps @ to_file, np.array(entry.probability))


def columns_of_file(direction: Floats) -> Floats:
    """What a step (21,) of the model moves, (22, 21): instead of two tangents, the three components of `direction`."""
    to_file = np.zeros((len(COLUMNS), SHARED))
    to_file[: ROTATION.stop, : ROTATION.stop] = np.eye(ROTATION.stop)
    to_file[ROTATION.stop :, TRANSLATION] = tangent_basis(direction)
    return to_file


class _PoseErrorsEntry(Entry):
    pose_covariance: list[list[Number]] = Field(default_factory=list)
    pose_by_calibration: list[list[Number]] = Field(default_factory=list)


def pose_error_entries(errors: PoseErrors, direction: Floats) -> dict[str, Any]:
    """Keys with a row for each of six numbers of each pose; none where the poses are not determined.

    `direction` (3,): of the calibration's translation, to whose three components a file's columns refer.
    """
    if not (np.isfinite(errors.covariance).all() and np.isfinite(errors.by_calibration).all()):
        return {}
    by_file = errors.by_calibration @ columns_of_file(direction / np.linalg.norm(direction)).T
    return {"pose_covariance": errors.covariance.tolist(), "pose_by_calibration": by_file.tolist()}


def read_pose_errors(path: Path, count: int, direction: Floats) -> PoseErrors | None:
    """The errors of `count` poses; None where the file states none. Raises InputError if they are malformed."""
    entry = validate(_PoseErrorsEntry, read_yaml(path), str(path))
    if not entry.pose_covariance:
        return None
    rows = PER_POSE * count
    for key, matrix, columns in (
        ("pose_covariance", entry.pose_covariance, rows),
        ("pose_by_calibration", entry.pose_by_calibration, len(COLUMNS)),
    ):
        if len(matrix) != rows or any(len(row) != columns for row in matrix):
            raise InputError(f"{path}: '{key}' must be {rows} rows of {columns} numbers")
    covariance = np.array(entry.pose_covariance)
    diagonal = np.diag(covariance)
    if diagonal.min() < 0 or diagonal.max() > _MOST_VARIANCE or not np.allclose(covariance, covariance.T):
        raise InputError(f"{path}: 'pose_covariance' is no covariance: negative, not symmetric, or beyond any scene")
    return PoseErrors(
        covariance, np.array(entry.pose_by_calibration) @ columns_of_file(direction / np.linalg.norm(direction))
    )


class _NetworkErrorsEntry(Entry):
    covariance: list[list[Number]] = Field(default_factory=list)
    known_distance: tuple[str, str] | None = None


@dataclass(frozen=True, eq=False)
class NetworkErrors:
    """How sure the devices of a network are."""

    covariance: Floats
    """(18 D, 18 D) of the devices' columns, as of `calib.networks.Network`, in the file's unit."""
    known_distance: tuple[str, str] | None
    """The devices whose distance is known, to which all lengths are scaled; None without a scale."""


def network_error_entries(estimate: NetworkEstimate, factor: float, known: tuple[str, str] | None) -> dict[str, Any]:
    """Keys for network.yaml; `factor`: the length of the estimate's unit in the file's."""
    count = PER_NODE * len(estimate.names)
    scale = np.ones(count)
    for device in range(len(estimate.names)):
        scale[PER_NODE * device :][PLACE] = factor
    covariance = scale[:, None] * estimate.covariance[:count, :count] * scale
    rows = [[float(f"{value:.{_DIGITS}g}") for value in row] for row in covariance.tolist()]
    entries: dict[str, Any] = {"covariance": rows} if np.isfinite(covariance).all() else {}
    return entries if known is None else entries | {"known_distance": [*known]}


def read_network_errors(path: Path, names: Sequence[str]) -> NetworkErrors | None:
    """Of devices with these names; None where the file states none, as older ones. Raises InputError for others."""
    entry = validate(_NetworkErrorsEntry, read_yaml(path), str(path))
    if not entry.covariance:
        return None
    size = PER_NODE * len(names)
    if len(entry.covariance) != size or any(len(row) != size for row in entry.covariance):
        raise InputError(f"{path}: 'covariance' must be {size} rows of as many numbers, {PER_NODE} for each device")
    covariance = np.array(entry.covariance)
    diagonal = np.diag(covariance)
    if diagonal.min() < 0 or diagonal.max() > _MOST_VARIANCE or not np.allclose(covariance, covariance.T, rtol=1e-5):
        raise InputError(f"{path}: 'covariance' is none: negative, not symmetric, or beyond any scene")
    known = entry.known_distance
    if known is not None and (known[0] == known[1] or not set(known) <= set(names)):
        raise InputError(f"{path}: 'known_distance' must be two of {', '.join(names)}, found {', '.join(known)}")
    return NetworkErrors(covariance, entry.known_distance)
