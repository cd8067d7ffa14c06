"""Matches and a calibration → clouds, unless the matches refute the calibration."""

from collections.abc import Sequence

import numpy as np

from calib.diagnostics import Uncertainty
from calib.finding import Finding, FindingKind
from calib.geometry import Calibration, Size
from calib.pointcloud import CloudStatistics, build_cloud
from calib.refusal import RefusalError
from calib.scene import find_change
from scanner.decoding import Decoding, MaskReason
from scanner.reconstruction.earlier_captures import refuse_moved
from scanner.results import Calibrated, Decoded, GivenCalibration, Reconstructed, Stage, naming
from scanner.ui import Progress

# Ray residuals beyond this over the whole image mean another rig or a changed pose.
_LARGEST_MISS_OF_WIDTH = 0.01
# A calibration from good faces leaves a few hundredths of a pixel; decoders with an uncorrected gamma some tenths.
_LARGEST_MISFIT_PX = 0.5
_LARGEST_MISFIT_OF_NOISE = 2.0
# Wrong stripes and reflections affect fewer pixels; another rig, or stripes along the baseline, affect most.
_MOST_UNCROSSED = 0.5
_OF_CROSSINGS = (MaskReason.KEPT, MaskReason.ALONG_EPIPOLAR_LINE, MaskReason.OUTSIDE)
_OF_ANOTHER_RIG = "Check that it belongs to this rig, and that nothing has moved since it was made."

OTHER_CALIBRATION = FindingKind(
    "other-calibration",
    "The given calibration does not fit the capture: it is of another rig, or the rig has changed.",
    "Give the rig's own calibration, or calibrate it again.",
    ("miss_px",),
)
ALONG_EPIPOLAR_LINES = FindingKind(
    "along-epipolar-lines",
    "Patterns vary along one axis only, and their stripes run along the epipolar lines, which carries no depth.",
    "Project patterns along the other axis instead, or along both.",
)
RAYS_MISS = FindingKind(
    "rays-miss",
    "Beside the faces of the corner, rays that should meet miss each other in a pattern.",
    "The faces may be bent or not square, or a lens has more distortion than the method models: choose another corner "
    "or view.",
    ("miss_px", "noise_px"),
)


def triangulate(captures: Sequence[Calibrated], reached: list[Stage], progress: Progress) -> tuple[Reconstructed, ...]:
    """Triangulate a cloud for each capture. Raises RefusalError; `reached` receives the stage that each capture has
    reached.
    """
    reconstructed = []
    for number, capture in enumerate(captures):
        with progress.step("Triangulating"), naming(capture.decoded, among=len(captures)):
            decoded = capture.decoded
            cloud = build_cloud(decoded.matches, decoded.texture, capture.calibration)
            stage = Reconstructed(capture, cloud)
            reached[number] = stage
            if isinstance(capture, GivenCalibration):
                refuse_moved(decoded)
                if decoded.decoding:
                    _refuse_uncrossed(decoded.decoding)
                refuse_foreign(cloud.statistics, decoded.metadata.projector_size)
            elif capture.solution.method == "refined":  # the paper's method ignores distortion, so a misfit is expected
                refuse_misfit(cloud.statistics)
        reconstructed.append(stage)
    return tuple(reconstructed)


def find_change_in(
    captures: Sequence[Decoded], calibration: Calibration, stated: Uncertainty | None
) -> tuple[Finding, ...]:
    """A warning if rays of captures do not meet under a given calibration, whose covariance may be `stated`; else ().

    A capture of one axis has its other coordinate from the calibration, and tests nothing.
    """
    both_axes = [capture.matches for capture in captures if capture.only_axis is None]
    return find_change(calibration, stated, both_axes)


def refuse_foreign(statistics: CloudStatistics, projector_size: Size) -> None:
    """Raise RefusalError if, by a given calibration, no rays meet, or all miss by more than lenses explain."""
    if statistics.kept == 0:
        reason = "The calibration puts no point in front of both camera and projector."
        raise RefusalError(OTHER_CALIBRATION, reason, _OF_ANOTHER_RIG)
    if statistics.calibration_px > _LARGEST_MISS_OF_WIDTH * projector_size.width:
        raise RefusalError(
            OTHER_CALIBRATION,
            f"With this calibration, rays that should meet miss by {statistics.calibration_px:.0f} projector pixels.",
            _OF_ANOTHER_RIG,
            {"miss_px": statistics.calibration_px},
        )


def _refuse_uncrossed(decoding: Decoding) -> None:
    """Raise RefusalError if only one axis was measured, and most epipolar lines do not cross the stripes seen."""
    axis = decoding.only_axis
    if axis is None:
        return
    counts = {reason: int(np.count_nonzero(decoding.reasons == reason)) for reason in _OF_CROSSINGS}
    total = sum(counts.values())
    if counts[MaskReason.ALONG_EPIPOLAR_LINE] > _MOST_UNCROSSED * total:
        raise RefusalError(
            ALONG_EPIPOLAR_LINES,
            f"Patterns vary along {axis} only, and their stripes run along the epipolar lines of this calibration at "
            f"{counts[MaskReason.ALONG_EPIPOLAR_LINE] / total:.0%} of the pixels, which carries no depth.",
            f"Project patterns along {'y' if axis == 'x' else 'x'} instead, or along both.",
        )
    if counts[MaskReason.OUTSIDE] > _MOST_UNCROSSED * total:
        raise RefusalError(
            OTHER_CALIBRATION,
            f"With this calibration, {counts[MaskReason.OUTSIDE] / total:.0%} of the pixels see a stripe that their "
            "epipolar line meets only outside the projector's image, or behind a device.",
            _OF_ANOTHER_RIG,
        )


def refuse_misfit(statistics: CloudStatistics) -> None:
    """Raise RefusalError if ray residuals have a pattern that good faces do not leave.

    All rays must meet, but only matches on the faces took part in the calibration. If the others miss, the assumed
    faces were not those of a corner.
    """
    if statistics.calibration_px > max(_LARGEST_MISFIT_PX, _LARGEST_MISFIT_OF_NOISE * statistics.decoder_px):
        raise RefusalError(
            RAYS_MISS,
            f"Beside the faces, rays that should meet miss by {statistics.calibration_px:.2g} projector pixels in a "
            f"pattern, where the decoder's noise is {statistics.decoder_px:.2g}.",
            "The faces of the corner may be bent or not square, or a lens has more distortion than the method models. "
            "Look at the faces in the report, and choose another corner or view.",
            {"miss_px": statistics.calibration_px, "noise_px": statistics.decoder_px},
        )
