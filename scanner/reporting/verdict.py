"""Can one trust this result? The answer in plain words, from the numbers."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from calib.diagnostics import FROM_ONE_PLACE
from calib.finding import Finding, of_kinds
from calib.geometry import Calibration
from calib.pointcloud import CloudStatistics
from calib.scene import BY_SCENE, CALIBRATION_CHANGED
from scanner.capture import CHANGED_SHAPE
from scanner.decoding import ONE_AXIS, UNCHECKED, UNSEEN_MOTION
from scanner.patterns import Axis
from scanner.quantities import intrinsic_errors_percent, percent, relative_focal_sigmas
from scanner.reporting.contents import ReportInput
from scanner.reporting.uncertainty import effect_of_principal_point
from scanner.results import MEASUREMENT_GRADE, Reconstructed, Refused, SelfCalibrated, Verdict

_SYSTEMATIC_MISS_PX = 1.0
# Smooth residuals beyond the noise bend a cloud visibly. In bad light, good decoders leave a tenth of a pixel.
_LEAST_SYSTEMATIC_PX, _SYSTEMATIC_OF_NOISE = 0.1, 2.5

_THREE_CAPTURES = (
    "For a measurement, scan the same corner from three places with the rig unchanged: scan --config FILE --captures 3"
)
_ONE_MORE = (
    "A further capture of the same corner with the unchanged rig lowers the sigmas, from a place where the faces show "
    "at different slants."
)
_NO_SIGMA = (
    "The uncertainty is not known. For captures of real rooms the paper, whose method this is, reports errors "
    "of 4 % on average."
)
_THIRD_PHOTO = "Add a photo of the same corner from another place, at the same zoom: three or four make a measurement."
_LOOK_AT_THE_MISSES = (
    "The rays miss each other in a pattern, see “Do the rays meet?”. Use 'method: refined', which knows lens "
    "distortion, or capture the corner again from another place."
)
_MORE_OF_IT = (
    "The rays miss each other in a pattern, see “Do the rays meet?”. Add captures in which what moves fills more of "
    "the picture: lenses are only known where it was."
)
_BOTH_AXES = "Project patterns along the other axis as well to check the calibration."
_SHORTER_FRINGES = "Project a shorter fringe along each axis as well, or the patterns of 'scan patterns'."
# Accuracy of the principal point after a calibration from boards.
_CALIBRATED_CENTRE_PX = 1.5
_MOST_BY_CENTRE = 0.01
_FREE_THE_CENTRE = (
    "Verify the principal point to a pixel, or leave camera.principal_point.known out and capture the same "
    "corner from two or three places: then it is measured."
)
_DOUBTFUL_CENTRE = "Calibrated, with a principal point that no ordinary camera has"
_CHECK_THE_CENTRE = (
    "Were the images cropped, or is camera.principal_point.known for another image size? Otherwise capture the "
    "corner again from another place."
)
# Effect on the intrinsics of a motion too small to be seen, one standard deviation.
_MOST_BY_MOTION_PERCENT = 0.5
_IF_NOTHING_MOVED = "Calibrated, if nothing moved between the axes"
_STANDARD_ORDER = "Capture again with the patterns of 'scan patterns': their order reveals motion."
_IF_PIXELS_ARE_SQUARE = "Calibrated, if the projector does not correct its picture's shape"
_TURN_OFF = "Turn off keystone correction, digital zoom and aspect correction in the projector's menu, and scan again."
_CHECK_THE_CALIBRATION = "Check that the calibration belongs to this rig, and that nothing has moved since it was made."


def verdict(report: ReportInput) -> Verdict:
    """The verdict on a result."""
    decision = replace(_of_outcome(report), findings=report.findings)
    return decision if report.scene is None else replace(decision, reasons=(report.scene.sentence, *decision.reasons))


def _of_outcome(report: ReportInput) -> Verdict:
    match report.outcome:
        case Refused(refusal=refusal):
            matched = f"{len(report.matches):,} matches were decoded and are kept in matches.npz."
            kinds = (refusal.finding.kind,)
            return Verdict("refused", "Not calibrated", (refusal.reason, matched), refusal.advice, kinds=kinds)
        case Reconstructed(SelfCalibrated() as calibrated, cloud):
            return _of_self_calibration(report, calibrated, cloud.statistics)
        case Reconstructed(cloud=cloud) if unchecked := of_kinds(report.findings, UNCHECKED):
            reasons = (*map(str, unchecked), *_about_matches(report))
            headline = "Reconstructed from fringes that nothing checks"
            return Verdict("fair", headline, reasons, _SHORTER_FRINGES, kinds=(UNCHECKED,))
        case Reconstructed(calibrated, cloud) if axis := calibrated.decoded.only_axis:
            return _of_one_axis(report, cloud.statistics, axis)
        case Reconstructed(calibrated, cloud) if by_scene := of_kinds(report.findings, BY_SCENE):
            return _of_scene(calibrated.calibration, cloud.statistics, by_scene[0], report.metadata.pixels)
        case Reconstructed(cloud=cloud):
            changed = of_kinds(report.findings, CALIBRATION_CHANGED)
            return _of_given(cloud.statistics, report.metadata.pixels, changed)


def _of_given(statistics: CloudStatistics, pixels: str, changed: Sequence[Finding]) -> Verdict:
    if changed:
        reasons = (changed[0].message, *_about_cloud(statistics, pixels))
        headline = "Reconstructed with a calibration that no longer holds"
        return Verdict("fair", headline, reasons, changed[0].advice, kinds=(CALIBRATION_CHANGED,))
    reasons = (
        "The calibration was taken as given; only its agreement with the matches was checked.",
        *_about_cloud(statistics, pixels),
    )
    if _misses_systematically(statistics):
        headline = "Reconstructed with a calibration that does not quite fit"
        return Verdict("fair", headline, reasons, _CHECK_THE_CALIBRATION)
    return Verdict("good", "Reconstructed with the calibration that was given", reasons)


def _of_scene(calibration: Calibration, statistics: CloudStatistics, finding: Finding, pixels: str) -> Verdict:
    reasons = (finding.message, *_about_cloud(statistics, pixels))
    worst = _worst_focal_sigma(calibration)
    if worst is None or worst > MEASUREMENT_GRADE:
        return Verdict("fair", "Calibrated without a corner, but roughly", reasons, finding.advice, kinds=(BY_SCENE,))
    if _misses_systematically(statistics):
        headline = "Calibrated without a corner, but with systematic errors"
        return Verdict("fair", headline, reasons, _MORE_OF_IT, kinds=(BY_SCENE,))
    return Verdict("good", "Calibrated by what the captures share, without a corner", reasons, kinds=(BY_SCENE,))


def _about_matches(report: ReportInput) -> Iterator[str]:
    sigma_px = report.matches.sigma_px
    if sigma_px is not None and len(sigma_px):
        yield f"The matches state a sigma of {np.median(sigma_px):.2g} {report.metadata.pixels} in the median."


def _of_one_axis(report: ReportInput, statistics: CloudStatistics, axis: Axis) -> Verdict:
    across = "y" if axis == "x" else "x"
    reasons = [
        f"Wherever there is a match, all patterns along {axis} agree.",
        *_about_matches(report),
        f"Only {axis} was measured. {across} is where the calibration's epipolar line crosses the stripe that a pixel "
        "sees, so that all rays meet: that cannot check the calibration, which was taken as given.",
    ]
    if statistics.matched:
        reasons.append(_about_points(statistics))
    headline = "Reconstructed with the calibration that was given, which one axis cannot check"
    return Verdict("good", headline, tuple(reasons), _BOTH_AXES, kinds=(ONE_AXIS,))


def _misses_systematically(statistics: CloudStatistics) -> bool:
    """Whether the rays' smooth misses are large, or larger than their noise: then they are what limits the cloud."""
    limit_px = max(_LEAST_SYSTEMATIC_PX, _SYSTEMATIC_OF_NOISE * statistics.decoder_px)
    return statistics.calibration_px > min(_SYSTEMATIC_MISS_PX, limit_px)


def _of_self_calibration(report: ReportInput, calibrated: SelfCalibrated, statistics: CloudStatistics) -> Verdict:
    calibration, metadata = calibrated.calibration, report.metadata
    worst = _worst_focal_sigma(calibration)
    reasons = [
        _NO_SIGMA
        if worst is None
        else f"The focal lengths are known to ± {100 * worst:.2g} % (one standard deviation).",
        f"On the three faces the calibration explains the matches to {calibrated.solution.residual_px:.2g} "
        f"{metadata.pixels}. That is necessary but no proof: wrong focal lengths can explain matches nearly as well.",
    ]
    if report.truth is not None:
        error = float(np.abs(intrinsic_errors_percent(calibration, report.truth)).mean())
        reasons.append(f"This rig is simulated, so the truth is known: the intrinsics err by {error:.2g} % on average.")
    reasons += _about_cloud(statistics, metadata.pixels)
    if doubt := _doubtful_centre(calibration):
        return Verdict("fair", _DOUBTFUL_CENTRE, (doubt, *reasons), _CHECK_THE_CENTRE)
    if _misses_systematically(statistics):
        return Verdict("fair", "Calibrated, but with systematic errors", tuple(reasons), _LOOK_AT_THE_MISSES)
    price = effect_of_principal_point(calibrated.solution)
    reasons += price.sentences
    if price.per_px * _CALIBRATED_CENTRE_PX > _MOST_BY_CENTRE:
        headline = "Calibrated, as well as the principal point that was given"
        return Verdict("fair", headline, (*price.sentences, *reasons[: -len(price.sentences)]), _FREE_THE_CENTRE)
    reasons += map(str, of_kinds(report.findings, FROM_ONE_PLACE))
    unseen, changed = of_kinds(report.findings, UNSEEN_MOTION), of_kinds(report.findings, CHANGED_SHAPE)
    if unseen or calibrated.solution.possible_percent > _MOST_BY_MOTION_PERCENT:
        kinds = UNSEEN_MOTION, FROM_ONE_PLACE
        return Verdict("fair", _IF_NOTHING_MOVED, (*map(str, unseen), *reasons), _STANDARD_ORDER, kinds=kinds)
    if changed:
        kinds = CHANGED_SHAPE, FROM_ONE_PLACE
        return Verdict("fair", _IF_PIXELS_ARE_SQUARE, (*map(str, changed), *reasons), _TURN_OFF, kinds=kinds)
    if worst is not None and worst <= MEASUREMENT_GRADE:
        return Verdict("good", "Calibrated, well enough to measure", tuple(reasons), kinds=(FROM_ONE_PLACE,))
    advice = _ONE_MORE if report.joint.count > 1 else _THREE_CAPTURES
    if metadata.photos:
        advice = _THIRD_PHOTO
    headline = "Calibrated, well enough for a first look"
    return Verdict("fair", headline, tuple(reasons), advice, kinds=(FROM_ONE_PLACE,))


def _doubtful_centre(calibration: Calibration) -> str | None:
    """A sentence if the camera's principal point is outside of its image; a projector's often is, by lens shift."""
    camera = calibration.camera
    (x, y), (width, height) = camera.principal_point_px, (camera.width, camera.height)
    if 0 <= x < width and 0 <= y < height:
        return None
    return f"The camera's principal point, ({x:.0f}, {y:.0f}), is outside its image of {width} × {height} pixels."


def _worst_focal_sigma(calibration: Calibration) -> float | None:
    """The larger relative sigma of the two focal lengths; None unless both are known."""
    known = relative_focal_sigmas(calibration)
    return max(known.values()) if len(known) == 2 else None


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
