"""Whether a calibration still holds, or ever did: what captures alone say of the rig, beside what a file says."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.diagnostics import Uncertainty, explain_change
from calib.geometry import Calibration
from calib.numerics import Floats
from calib.refinement import CAMERA, PROJECTOR, SHARED
from scanner.calibration_job import calibrate
from scanner.comparing import CalibrationComparison, compare_files, comparison_verdict
from scanner.configuration import Config, load_config
from scanner.errors import InputError
from scanner.io import read_calibration
from scanner.results import CALIBRATION_FILE, Verdict, read_uncertainty
from scanner.rooms import state_of
from scanner.ui import Terminal


@dataclass(frozen=True)
class CalibrationCheck:
    """A calibration that was given, beside the one that captures determine without it."""

    comparison: CalibrationComparison
    """Where in the picture they differ."""
    verdict: Verdict
    """Whether the given one holds, and what has changed."""


def check_calibration(
    given: Path, captures: Sequence[Path], config: Config, out: Path, terminal: Terminal
) -> CalibrationCheck:
    """Calibrate from captures of a corner, or three or more of anything, into `out`, and compare with a given file.

    Raises InputError, RefusalError if the captures determine no calibration.
    """
    file = given / CALIBRATION_FILE if given.is_dir() else given
    calibration = read_calibration(file)
    scan = calibrate(captures, config, out, terminal=terminal)
    estimate = scan.newest.uncertainty
    if estimate is None:
        raise InputError("'method: paper' states no uncertainty to judge a calibration by: use 'method: refined'")
    comparison = compare_files(file, out)
    return CalibrationCheck(
        comparison, _verdict(comparison, calibration, read_uncertainty(file, calibration), estimate)
    )


def config_of(given: Path, overrides: Sequence[str] = ()) -> Config:
    """A configuration for captures by the devices of a calibration file, with KEY=VALUE overrides.

    Raises InputError.
    """
    sizes = read_calibration(given / CALIBRATION_FILE if given.is_dir() else given).sizes
    keys = [
        f"{device}.{name}={getattr(size, name)}"
        for device, size in zip(("camera", "projector"), sizes, strict=True)
        for name in ("width", "height")
    ]
    return load_config(None, [*keys, *overrides])


def _verdict(
    comparison: CalibrationComparison, given: Calibration, stated: Uncertainty | None, estimate: Uncertainty
) -> Verdict:
    """That of the comparison, in words of one file that is judged."""
    verdict = comparison_verdict(comparison)
    state, covariance = state_of(given), np.zeros((SHARED, SHARED)) if stated is None else stated.covariance
    reasons = (*_focal_lengths(state.step_to(estimate.rig), covariance, estimate.covariance), *verdict.reasons)
    if verdict.grade != "refused":
        return replace(verdict, headline="The calibration holds, as far as these captures can tell.", reasons=reasons)
    change = explain_change(state, covariance, estimate)
    return Verdict(
        "refused",
        "The calibration does not hold.",
        (f"{change}.", *reasons),
        "If the rig is as it was for these captures, use what they say: it is the result's calibration.yaml.",
    )


def _focal_lengths(step: Floats, given: Floats, estimate: Floats) -> Iterator[str]:
    for name, column in (("camera", CAMERA.start), ("projector", PROJECTOR.start)):
        error, sigma = -100 * step[column], 100 * np.sqrt(given[column, column] + estimate[column, column])
        direction = "longer" if error > 0 else "shorter"
        yield f"The file's focal length of the {name} is {abs(error):.2g} % {direction}, ± {sigma:.2g} %."
