"""The covariance of a network's devices as a key of network.yaml, and the known distance that gives its scale."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from calib.networks import PER_NODE, PLACE, NetworkEstimate
from calib.numerics import Floats
from scanner.errors import InputError
from scanner.io import Entry, Number, read_yaml, validate

_DIGITS = 8
_MOST_VARIANCE = 1e24


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
