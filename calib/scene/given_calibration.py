"""Whether rays meet under a calibration that was given: what changed since, by how much, and whether to say so."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnostics import RigChange, Uncertainty, explain_change
from calib.finding import Finding, FindingKind, Severity
from calib.geometry import Calibration, Matches
from calib.refinement import SHARED
from calib.scene.epipolar_lines import RigByLines, in_square_pixels, rig_by_lines
from calib.scene.views import some_matches

_QUICK = 2000  # matches: 0.07 s
_FEWEST = 500
_SMOOTH_PX = 0.05  # what a decoder's smooth errors leave
# As a share of the projector's width, a good calibration leaves less: real captures under one from boards up to 0.14 px
# of 1024. One that states no sigmas may be worse: published ones leave 0.3 to 0.6 px of 1024 or 1280.
_LEAST_PX, _LEAST, _LEAST_UNSTATED = 0.15, 2.5e-4, 6e-4

CALIBRATION_CHANGED = FindingKind(
    "calibration-changed",
    "Rays miss each other under the given calibration by more than chance and its sigmas explain: the rig has changed.",
    "Estimate it anew with scan check CAPTURE --calibration FILE --update, or calibrate the rig again.",
    ("excess_px", "given_px", "best_px"),
)


@dataclass(frozen=True, eq=False)
class LineTest:
    """A given calibration beside the rig near it under which rays meet best."""

    lines: RigByLines
    """What matches say of it."""
    change: RigChange
    """What leads from the calibration to them."""
    usual_px: float
    """The excess that good calibrations leave."""

    @property
    def excess_px(self) -> float:
        """By how much rays miss each other because of the change, in projector px: one standard deviation."""
        return float(np.sqrt(max(self.lines.given_px**2 - self.lines.best_px**2, 0.0)))

    @property
    def holds(self) -> bool:
        """Whether chance, or a decoder's smooth errors, explain how far rays miss each other."""
        return not self.change.is_significant or self.excess_px < _SMOOTH_PX

    @property
    def is_usual(self) -> bool:
        """Whether rays miss each other by no more than they do under good calibrations."""
        return self.holds or self.excess_px < self.usual_px


def compare_with_lines(
    calibration: Calibration, stated: Uncertainty | None, captures: Sequence[Matches], count: int
) -> LineTest:
    """The test by at most `count` matches, both of whose coordinates were measured."""
    given, matches = in_square_pixels(calibration, some_matches(captures, count // len(captures)).matches)
    covariance = np.zeros((SHARED, SHARED)) if stated is None else stated.covariance
    lines = rig_by_lines(given, matches)
    precision = lines.information @ np.linalg.inv(np.eye(SHARED) + covariance @ lines.information)
    least_px = calibration.projector.width * (_LEAST_UNSTATED if stated is None else _LEAST)
    return LineTest(lines, explain_change(lines.step, precision), max(_LEAST_PX, least_px))


def find_change(
    calibration: Calibration, stated: Uncertainty | None, captures: Sequence[Matches]
) -> tuple[Finding, ...]:
    """A warning if rays do not meet under a given calibration; () if they do, or too few say so.

    It has to be beyond chance (0.9999), and to be more than what decoders and calibrations usually leave.
    """
    if sum(map(len, captures)) < _FEWEST:
        return ()
    test = compare_with_lines(calibration, stated, captures, _QUICK)
    if test.is_usual:
        return ()
    lines = test.lines
    message = (
        f"Under the given calibration rays miss each other by {lines.given_px:.2g} projector px, where "
        f"{lines.best_px:.2g} would be possible. {test.change}."
    )
    data = {"excess_px": test.excess_px, "given_px": lines.given_px, "best_px": lines.best_px}
    return (Finding(CALIBRATION_CHANGED, Severity.WARNING, message, CALIBRATION_CHANGED.remedy, data),)
