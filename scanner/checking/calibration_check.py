"""Whether a calibration still holds, or ever did: what captures alone say of the rig, beside what a file says."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.diagnostics import Uncertainty, explain_change
from calib.geometry import Calibration
from calib.numerics import Floats
from calib.refinement import CAMERA, PROJECTOR, SHARED, KnownRig
from calib.refusal import RefusalError
from calib.scene import compare_with_lines
from scanner.calibration_job import calibrate
from scanner.comparing import CalibrationComparison, compare_files, comparison_verdict
from scanner.configuration import Config, load_config
from scanner.errors import InputError
from scanner.io import read_calibration
from scanner.jobs import scan
from scanner.reconstruction import read_captures
from scanner.results import Decoded, Verdict, calibration_file, read_uncertainty
from scanner.rooms import state_of
from scanner.ui import Terminal

_MATCHES = 6000
_FOR_MORE = "One capture of a corner, or three of anything from different sides, test all of it."


@dataclass(frozen=True)
class CalibrationCheck:
    """A calibration that was given, beside the one that captures determine without it."""

    comparison: CalibrationComparison | None
    """Where in the picture they differ; None if only epipolar lines were compared."""
    verdict: Verdict
    """Whether the given one holds, and what has changed."""


def check_calibration(
    given: Path, captures: Sequence[Path], config: Config, out: Path, terminal: Terminal
) -> CalibrationCheck:
    """Calibrate from captures of a corner, or three or more of anything, into `out`, and compare with a given file.

    Captures that determine no calibration still tell whether rays meet. Raises InputError.
    """
    file = calibration_file(given)
    calibration = read_calibration(file)
    stated = read_uncertainty(file, calibration)
    try:
        scan = calibrate(captures, config, out, terminal=terminal)
    except RefusalError as refusal:
        decoded = read_captures([out], *calibration.sizes)  # a refused result keeps its matches
        return CalibrationCheck(None, _verdict_by_lines(calibration, stated, decoded, refusal))
    estimate = scan.newest.uncertainty
    if estimate is None:
        raise InputError("'method: paper' states no uncertainty to judge a calibration by: use 'method: refined'")
    comparison = compare_files(file, out)
    return CalibrationCheck(comparison, _verdict(comparison, calibration, stated, estimate))


def take_capture(config: Config, out: Path, terminal: Terminal) -> Path:
    """`out`, with one capture of whatever stands before the configured rig. Raises InputError, DeviceError."""
    with suppress(RefusalError):  # its matches are kept, whatever they show
        scan(config, out, terminal=terminal)
    return out


def config_of(given: Path, overrides: Sequence[str] = ()) -> Config:
    """A configuration for captures by the devices of a calibration file, with KEY=VALUE overrides.

    Raises InputError.
    """
    sizes = read_calibration(calibration_file(given)).sizes
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
    rig = KnownRig(state, covariance + estimate.covariance)
    change = explain_change(rig.step_to(estimate.rig), rig.precision)
    return Verdict(
        "refused",
        "The calibration does not hold.",
        (f"{change}.", *reasons),
        "If the rig is as it was for these captures, use what they say: it is the result's calibration.yaml.",
    )


def _verdict_by_lines(
    given: Calibration, stated: Uncertainty | None, captures: Sequence[Decoded], refusal: RefusalError
) -> Verdict:
    """Whether the rays of captures meet that determine no calibration."""
    test = compare_with_lines(given, stated, [capture.matches for capture in captures], _MATCHES)
    reasons = (
        f"Under it rays miss each other by {test.lines.given_px:.2g} projector px (one standard deviation); at best "
        f"they would by {test.lines.best_px:.2g}.",
        f"Only whether rays meet was tested; a change that leaves them meeting is not seen. {refusal.reason}",
    )
    if test.holds:
        return Verdict("good", "The calibration holds, as far as rays that meet can tell.", reasons, _FOR_MORE)
    headline = "The calibration does not hold: rays do not meet."
    return Verdict("refused", headline, (f"{test.change}.", *reasons), _FOR_MORE)


def _focal_lengths(step: Floats, given: Floats, estimate: Floats) -> Iterator[str]:
    for name, column in (("camera", CAMERA.start), ("projector", PROJECTOR.start)):
        error, sigma = -100 * step[column], 100 * np.sqrt(given[column, column] + estimate[column, column])
        direction = "longer" if error > 0 else "shorter"
        yield f"The file's focal length of the {name} is {abs(error):.2g} % {direction}, ± {sigma:.2g} %."
