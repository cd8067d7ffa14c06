"""Matches and a calibration → clouds, unless the matches refute the calibration."""

from collections.abc import Sequence

from calib.geometry import Size
from calib.pointcloud import CloudStatistics, build_cloud
from calib.refusal import RefusalError
from scanner.results import Calibrated, GivenCalibration, Reconstructed, Stage, naming
from scanner.ui import Progress

# A calibration whose rays miss each other by more than this, all over the image, is of another rig or of another pose.
_LARGEST_MISS_OF_WIDTH = 0.01
# A calibration from good faces leaves a few hundredths of a pixel; decoders with an uncorrected gamma some tenths.
_LARGEST_MISFIT_PX = 0.5
_LARGEST_MISFIT_OF_NOISE = 2.0


def triangulate(captures: Sequence[Calibrated], reached: list[Stage], progress: Progress) -> tuple[Reconstructed, ...]:
    """A cloud for each capture. Raises RefusalError; `reached` is told how far each capture got."""
    reconstructed = []
    for number, capture in enumerate(captures):
        with progress.step("Triangulating"), naming(capture.decoded, among=len(captures)):
            decoded = capture.decoded
            cloud = build_cloud(decoded.matches, decoded.texture, capture.calibration)
            found = Reconstructed(capture, cloud)
            reached[number] = found
            if isinstance(capture, GivenCalibration):
                _refuse_foreign(cloud.statistics, decoded.facts.projector_size)
            elif capture.solution.method == "refined":  # the paper's leaves out lenses: a misfit is to be expected
                refuse_misfit(cloud.statistics)
        reconstructed.append(found)
    return tuple(reconstructed)


def _refuse_foreign(statistics: CloudStatistics, projector_size: Size) -> None:
    """Raise RefusalError if, by a given calibration, no rays meet, or all miss by more than lenses explain."""
    advice = "Check that it belongs to this rig, and that nothing has moved since it was made."
    if statistics.kept == 0:
        raise RefusalError("The calibration puts no point in front of both camera and projector.", advice)
    if statistics.calibration_px > _LARGEST_MISS_OF_WIDTH * projector_size.width:
        raise RefusalError(
            f"With this calibration, rays that should meet miss by {statistics.calibration_px:.0f} projector pixels.",
            advice,
        )


def refuse_misfit(statistics: CloudStatistics) -> None:
    """Raise RefusalError if rays miss each other in a pattern that a calibration made from good faces does not leave.

    All matches have to meet, whatever they are on, but only those on the faces took part in the calibration: where the
    others miss, what was taken for faces of a corner was none.
    """
    if statistics.calibration_px > max(_LARGEST_MISFIT_PX, _LARGEST_MISFIT_OF_NOISE * statistics.decoder_px):
        raise RefusalError(
            f"Beside the faces, rays that should meet miss by {statistics.calibration_px:.2g} projector pixels in a "
            f"pattern, where the decoder's noise is {statistics.decoder_px:.2g}.",
            "What was taken for the faces of a corner may be bent, or not square; or a lens bends more than the method "
            "allows for. Look at the faces in the report, and choose another corner or view.",
        )
