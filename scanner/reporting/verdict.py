"""Can one trust this result? The answer in plain words, from the numbers."""

from collections.abc import Iterator

import numpy as np

from calib.geometry import Calibration
from calib.pointcloud import CloudStatistics
from scanner.patterns import Axis
from scanner.quantities import intrinsic_errors_percent, percent
from scanner.reporting.contents import ReportInput
from scanner.results import Reconstructed, Refused, SelfCalibrated, Verdict

# A focal length that errs by one per cent bends a room by about as much as its walls are off square.
_MEASUREMENT_GRADE = 0.01
_SYSTEMATIC_MISS_PX = 1.0

_THREE_CAPTURES = (
    "For a measurement, capture the same corner three times from different places with the rig unchanged, and "
    "calibrate them together."
)
_ONE_MORE = (
    "A further capture of the same corner by the unchanged rig makes it surer, from a place where the faces show at "
    "other slants than before."
)
_NO_SIGMA = (
    "How sure the numbers are is not known. For captures of real rooms the paper, whose method this is, reports errors "
    "of 4 % on average."
)
_THIRD_PHOTO = "Add a photo of the same corner from another place, at the same zoom: three or four make a measurement."
_LOOK_AT_THE_MISSES = (
    "The rays miss each other in a pattern, see “Do the rays meet?”. Use 'method: refined', which knows lens "
    "distortion, or capture the corner again from another place."
)
_BOTH_AXES = "To see whether the calibration still fits, project patterns along the other axis as well."
_CHECK_THE_CALIBRATION = "Check that the calibration belongs to this rig, and that nothing has moved since it was made."


def verdict(report: ReportInput) -> Verdict:
    """The verdict on a result."""
    match report.outcome:
        case Refused(refusal=refusal):
            matched = f"{len(report.matches):,} matches were decoded and are kept in matches.npz."
            return Verdict("refused", "Not calibrated", (refusal.reason, matched), refusal.advice)
        case Reconstructed(SelfCalibrated() as calibrated, cloud):
            return _of_self_calibration(report, calibrated, cloud.statistics)
        case Reconstructed(calibrated, cloud) if axis := calibrated.decoded.only_axis:
            return _of_one_axis(cloud.statistics, axis)
        case Reconstructed(cloud=cloud):
            return _of_given(cloud.statistics, report.facts.pixels)


def _of_given(statistics: CloudStatistics, pixels: str) -> Verdict:
    reasons = (
        "The calibration was taken as it is; only its agreement with the matches was checked.",
        *_about_cloud(statistics, pixels),
    )
    if statistics.calibration_px > _SYSTEMATIC_MISS_PX:
        headline = "Reconstructed with a calibration that does not quite fit"
        return Verdict("fair", headline, reasons, _CHECK_THE_CALIBRATION)
    return Verdict("good", "Reconstructed with the calibration that was given", reasons)


def _of_one_axis(statistics: CloudStatistics, axis: Axis) -> Verdict:
    other = "y" if axis == "x" else "x"
    reasons = [
        f"Only {axis} was measured. {other} is where the calibration's epipolar line crosses the stripe that a pixel "
        "sees, so that the rays of every match meet: that says nothing about the calibration, which was taken as it is."
    ]
    if statistics.matched:
        reasons.append(_about_points(statistics))
    return Verdict("fair", "Reconstructed with a calibration that nothing checks", tuple(reasons), _BOTH_AXES)


def _of_self_calibration(report: ReportInput, calibrated: SelfCalibrated, statistics: CloudStatistics) -> Verdict:
    calibration, facts = calibrated.calibration, report.facts
    worst = _worst_focal_sigma(calibration)
    reasons = [
        _NO_SIGMA
        if worst is None
        else f"The focal lengths are known to ± {100 * worst:.2g} % (one standard deviation).",
        f"On the three faces the calibration explains the matches to {calibrated.solution.residual_px:.2g} "
        f"{facts.pixels}. That is needed, but it is no proof: wrong focal lengths can explain matches nearly as well.",
    ]
    if report.truth is not None:
        error = float(np.abs(intrinsic_errors_percent(calibration, report.truth)).mean())
        reasons.append(f"This rig is simulated, so the truth is known: the intrinsics err by {error:.2g} % on average.")
    reasons += _about_cloud(statistics, facts.pixels)
    if statistics.calibration_px > _SYSTEMATIC_MISS_PX:
        return Verdict("fair", "Calibrated, but with errors that show", tuple(reasons), _LOOK_AT_THE_MISSES)
    if worst is not None and worst <= _MEASUREMENT_GRADE:
        return Verdict("good", "Calibrated, well enough to measure", tuple(reasons))
    advice = _ONE_MORE if report.company.count > 1 else _THREE_CAPTURES
    if facts.photos:
        advice = _THIRD_PHOTO
    return Verdict("fair", "Calibrated, well enough for a first look", tuple(reasons), advice)


def _worst_focal_sigma(calibration: Calibration) -> float | None:
    """The larger relative sigma of the two focal lengths; None unless both are known."""
    relative = []
    for device, sigmas in (
        (calibration.camera, calibration.sigma.camera),
        (calibration.projector, calibration.sigma.projector),
    ):
        if sigmas.focal_px is None:
            return None
        relative.append(max(sigmas.focal_px) / device.focal_px[0])
    return max(relative)


def _about_cloud(statistics: CloudStatistics, pixels: str) -> Iterator[str]:
    source = "the decoder" if pixels == "projector px" else "the features"
    if not statistics.matched:
        return
    yield _about_points(statistics)
    yield (
        f"The two rays of a match miss each other by {statistics.decoder_px:.2g} {pixels} at random ({source}) "
        f"and by {statistics.calibration_px:.2g} px in a smooth pattern (the calibration)."
    )


def _about_points(statistics: CloudStatistics) -> str:
    kept = percent(statistics.kept / statistics.matched)
    return f"{statistics.kept:,} of {statistics.matched:,} matches ({kept}) became points of the cloud."
