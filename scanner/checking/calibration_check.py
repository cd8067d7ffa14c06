"""Whether a calibration still holds, or ever did: what captures alone say of the rig, beside what a file says."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.diagnostics import RigChange, Uncertainty, explain_change
from calib.geometry import Calibration, Matches
from calib.numerics import Floats
from calib.refinement import CAMERA, PROJECTOR, SHARED, KnownRig
from calib.refusal import RefusalError
from calib.scene import LineTest, compare_with_lines
from scanner.comparing import CalibrationComparison, NamedCalibration, compare_calibrations, comparison_verdict
from scanner.configuration import Config, load_config
from scanner.errors import InputError
from scanner.io import read_calibration
from scanner.jobs import calibrate_captures, read_to_calibrate, scan
from scanner.results import Scan, Verdict, calibration_file, read_uncertainty
from scanner.rooms import state_of
from scanner.ui import Terminal

LINE_MATCHES = 6000
_FOR_MORE = "One capture of a corner, or three of anything from different sides, test all of it."


@dataclass(frozen=True, eq=False)
class CalibrationCheck:
    """A calibration that was given, beside what captures say without it."""

    calibration: Calibration
    """The one that was given."""
    stated: Uncertainty | None
    """Its own covariance, if it states one."""
    matches: tuple[Matches, ...]
    """Those of the captures."""
    estimate: Scan | None
    """What the captures determine by themselves; None if only whether rays meet."""
    test: LineTest
    """Whether rays meet under the given one."""
    change: RigChange
    """What leads from the given calibration to the captures."""
    comparison: CalibrationComparison | None
    """Where in the picture both differ; None without an estimate."""
    verdict: Verdict
    """Whether the given one holds, and what has changed."""

    @property
    def holds(self) -> bool:
        """Whether the given calibration may be that of the captures."""
        return self.verdict.grade != "refused"


def check_calibration(
    given: Path, captures: Sequence[Path], config: Config, out: Path | None, terminal: Terminal
) -> CalibrationCheck:
    """Calibrate from captures of a corner, or three or more of anything, and compare with a given file.

    What they say is a result in `out`, if that is given. Captures that determine no calibration still tell whether rays
    meet. Raises InputError.
    """
    file = calibration_file(given)
    calibration = read_calibration(file)
    stated = read_uncertainty(file, calibration)
    decoded, settings = read_to_calibrate(captures, config, terminal)
    try:
        scan = calibrate_captures(decoded, settings, out, terminal=terminal)
    except RefusalError as refusal:
        matches = tuple(capture.matches for capture in decoded)
        test = compare_with_lines(calibration, stated, matches, LINE_MATCHES)
        verdict = _verdict_by_lines(test, refusal)
        return CalibrationCheck(calibration, stated, matches, None, test, test.change, None, verdict)
    estimate = scan.newest.uncertainty
    if estimate is None:
        raise InputError("'method: paper' states no uncertainty to judge a calibration by: use 'method: refined'")
    matches = tuple(capture.decoded.matches for capture in scan.captures)
    test = compare_with_lines(calibration, stated, matches, LINE_MATCHES)
    comparison = compare_calibrations(
        NamedCalibration(str(file), calibration, stated, lambda: None),
        NamedCalibration("the captures' own", scan.newest.calibration, estimate, lambda: matches[-1]),
    )
    state, covariance = state_of(calibration), np.zeros((SHARED, SHARED)) if stated is None else stated.covariance
    rig = KnownRig(state, covariance + estimate.covariance)
    step = rig.step_to(estimate.rig)
    change = explain_change(step, rig.precision)
    focal_lengths = _focal_lengths(step, covariance, estimate.covariance)
    verdict = _verdict(comparison, change, (*focal_lengths, *_at_a_metre(comparison)))
    return CalibrationCheck(calibration, stated, matches, scan, test, change, comparison, verdict)


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


def _verdict(comparison: CalibrationComparison, change: RigChange, by_numbers: tuple[str, ...]) -> Verdict:
    """That of the comparison, in words of one file that is judged."""
    verdict = comparison_verdict(comparison)
    reasons = (*by_numbers, *verdict.reasons)
    if verdict.grade != "refused":
        return replace(verdict, headline="The calibration holds, as far as these captures can tell.", reasons=reasons)
    return Verdict(
        "refused",
        "The calibration does not hold.",
        (f"{change}.", *reasons),
        "If the rig is as it was for these captures, use what they say: it is the result's calibration.yaml, or with "
        "--update both together.",
    )


def _verdict_by_lines(test: LineTest, refusal: RefusalError) -> Verdict:
    """Whether the rays of captures meet that determine no calibration."""
    reasons = (
        f"Under it rays miss each other by {test.lines.given_px:.2g} projector px (one standard deviation); at best "
        f"they would by {test.lines.best_px:.2g}.",
        f"Only whether rays meet was tested; a change that leaves them meeting is not seen. {refusal.reason}",
    )
    if test.holds:
        return Verdict("good", "The calibration holds, as far as rays that meet can tell.", reasons, _FOR_MORE)
    if test.is_usual:
        headline = "The calibration nearly holds: rays miss each other by no more than good calibrations leave."
        return Verdict("fair", headline, (f"{test.change}.", *reasons), _FOR_MORE)
    headline = "The calibration does not hold: rays do not meet."
    return Verdict("refused", headline, (f"{test.change}.", *reasons), _FOR_MORE)


def _at_a_metre(comparison: CalibrationComparison) -> Iterator[str]:
    """By how much lengths are off because of the given calibration, as a share of the distance."""
    difference = comparison.difference
    relative = difference.length / difference.depth
    sigma = difference.length_sigma / difference.depth
    usual, own = float(np.sqrt(np.mean(relative**2))), float(np.sqrt(np.mean(sigma**2)))
    yield (
        f"Apart from a common motion, points under it are off by {100 * usual:.2g} % of their distance, ± "
        f"{100 * own:.2g} %: {1000 * usual:.2g} mm at one metre, ± {1000 * own:.2g} mm."
    )


def _focal_lengths(step: Floats, given: Floats, estimate: Floats) -> Iterator[str]:
    for name, column in (("camera", CAMERA.start), ("projector", PROJECTOR.start)):
        error, sigma = -100 * step[column], 100 * np.sqrt(given[column, column] + estimate[column, column])
        direction = "longer" if error > 0 else "shorter"
        yield f"The file's focal length of the {name} is {abs(error):.2g} % {direction}, ± {sigma:.2g} %."
