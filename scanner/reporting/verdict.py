"""Can one trust this result? The answer in plain words, from the numbers."""

from collections.abc import Iterator

import numpy as np

from calib.geometry import Calibration
from calib.pointcloud import CloudStatistics
from scanner.quantities import intrinsic_errors_percent, percent
from scanner.reporting.contents import ReportInput
from scanner.results import Verdict

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
_CHECK_THE_CALIBRATION = "Check that the calibration belongs to this rig, and that nothing has moved since it was made."


def verdict(report: ReportInput) -> Verdict:
    """The verdict on a result."""
    if report.refusal is not None:
        matched = f"{len(report.matches):,} matches were decoded and are kept in matches.npz."
        return Verdict("refused", "Not calibrated", (report.refusal.reason, matched), report.refusal.advice)
    assert report.calibration is not None
    if report.solution is None:
        return _of_given(report)
    return _of_self_calibration(report, report.calibration)


def _of_given(report: ReportInput) -> Verdict:
    reasons = ["The calibration was taken as it is; only its agreement with the matches was checked."]
    if report.cloud is not None:
        reasons += _about_cloud(report.cloud.statistics, report.capture.pixels)
    if _misses_systematically(report):
        headline = "Reconstructed with a calibration that does not quite fit"
        return Verdict("fair", headline, tuple(reasons), _CHECK_THE_CALIBRATION)
    return Verdict("good", "Reconstructed with the calibration that was given", tuple(reasons))


def _misses_systematically(report: ReportInput) -> bool:
    return report.cloud is not None and report.cloud.statistics.calibration_px > _SYSTEMATIC_MISS_PX


def _of_self_calibration(report: ReportInput, calibration: Calibration) -> Verdict:
    assert report.solution is not None
    worst = _worst_focal_sigma(calibration)
    reasons = [
        _NO_SIGMA
        if worst is None
        else f"The focal lengths are known to ± {100 * worst:.2g} % (one standard deviation).",
        f"On the three faces the calibration explains the matches to {report.solution.residual_px:.2g} "
        f"{report.capture.pixels}. That is needed, but it is no proof: wrong focal lengths can explain matches nearly "
        "as well.",
    ]
    if report.truth is not None:
        error = float(np.abs(intrinsic_errors_percent(calibration, report.truth)).mean())
        reasons.append(f"This rig is simulated, so the truth is known: the intrinsics err by {error:.2g} % on average.")
    if report.cloud is not None:
        reasons += _about_cloud(report.cloud.statistics, report.capture.pixels)
    if _misses_systematically(report):
        return Verdict("fair", "Calibrated, but with errors that show", tuple(reasons), _LOOK_AT_THE_MISSES)
    if worst is not None and worst <= _MEASUREMENT_GRADE:
        return Verdict("good", "Calibrated, well enough to measure", tuple(reasons))
    advice = _ONE_MORE if report.together > 1 else _THREE_CAPTURES
    if report.capture.photos:
        advice = _THIRD_PHOTO
    return Verdict("fair", "Calibrated, well enough for a first look", tuple(reasons), advice)


def _worst_focal_sigma(calibration: Calibration) -> float | None:
    """The larger relative sigma of the two focal lengths; None unless both are known."""
    relative = []
    for device, key in ((calibration.camera, "camera_focal_px"), (calibration.projector, "projector_focal_px")):
        sigma = calibration.sigma.get(key)
        if sigma is None:
            return None
        relative.append(float(np.max(sigma)) / device.focal_px[0])
    return max(relative)


def _about_cloud(statistics: CloudStatistics, pixels: str) -> Iterator[str]:
    source = "the decoder" if pixels == "projector px" else "the features"
    if not statistics.matched:
        return
    kept = percent(statistics.kept / statistics.matched)
    yield f"{statistics.kept:,} of {statistics.matched:,} matches ({kept}) became points of the cloud."
    yield (
        f"The two rays of a match miss each other by {statistics.decoder_px:.2g} {pixels} at random ({source}) "
        f"and by {statistics.calibration_px:.2g} px in a smooth pattern (the calibration)."
    )
