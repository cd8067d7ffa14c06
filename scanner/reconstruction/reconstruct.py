"""Captures → faces → one calibration → clouds → files.

What was found is written into `folder` also when RefusalError is raised: the matches of a capture that cannot be
calibrated are worth keeping, and the report says why.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

from calib.diagnostics import Uncertainty
from calib.finding import Finding
from calib.geometry import Calibration
from calib.numerics import Bools
from calib.refusal import RefusalError
from hw.ahead import in_background
from scanner.configuration import Config, ScaleSettings
from scanner.quantities import UNKNOWN_UNIT
from scanner.reconstruction.calibrate import calibrate, label
from scanner.reconstruction.merge_clouds import merge
from scanner.reconstruction.metric_scale import scaled, scaled_by_sheet
from scanner.reconstruction.save import EarlyMatches, refusal_saved, save
from scanner.reconstruction.triangulate import find_change_in, triangulate
from scanner.results import Decoded, GivenCalibration, Reconstructed, Scan, SelfCalibrated
from scanner.ui import Progress

# Captures without a corner, which the refusal says, calibrated by what they share, and findings on that.
WithoutCorner = Callable[
    [Sequence[Decoded], Config, Progress, RefusalError], tuple[Sequence[GivenCalibration], tuple[Finding, ...]]
]
OnCloud = Callable[[Scan], object]  # called with the clouds once they exist, while they are being saved


def reconstruct(
    captures: Sequence[Decoded],
    config: Config,
    folder: Path | None,
    progress: Progress,
    *,
    masks: Bools | None = None,
    given: tuple[Calibration, Uncertainty | None] | None = None,
    without_corner: WithoutCorner | None = None,
    on_cloud: OnCloud | None = None,
) -> Scan:
    """Calibrate, triangulate, and write the result into `folder`, if there is one; `masks` are of the newest capture.

    `given`: a calibration and its covariance, used instead of calibrating. `without_corner`: how captures without a
    corner are calibrated. Raises RefusalError.
    """
    with EarlyMatches(folder) as matches:
        with refusal_saved(captures, folder, config, matches) as reached:
            if given is not None:
                matches.begin(captures)
                known = [_given(capture, *given, config.scale) for capture in captures]
                clouds = triangulate(known, reached, progress)
                scan = Scan(clouds, own_findings=find_change_in(captures, known[0].calibration, known[0].stated))
            else:
                try:
                    with progress.step("Calibrating"):
                        labelled = label(captures, reached, config, masks)
                        matches.begin(labelled)
                        reached[:] = calibrated = calibrate(labelled, config)
                except RefusalError as no_corner:
                    if without_corner is None:
                        raise
                    shared, findings = without_corner(captures, config, progress, no_corner)
                    scan = Scan(triangulate(shared, reached, progress), own_findings=findings)
                else:
                    scan = _merged(calibrated, triangulate(calibrated, reached, progress), config, progress)
        if folder is None:
            return scan
        with progress.step("Writing the result"), in_background(on_cloud or _ignore) as tell:
            tell(scan)
            save(scan, folder, config, matches)
    return scan


def _given(
    capture: Decoded, calibration: Calibration, stated: Uncertainty | None, scale: ScaleSettings | None
) -> GivenCalibration:
    """The capture with its rig, at the scale of the configuration."""
    charuco = scale.charuco if scale and calibration.unit == UNKNOWN_UNIT else None
    if charuco is not None:
        return GivenCalibration(capture, *scaled_by_sheet(calibration, stated, [capture], charuco))
    return GivenCalibration(capture, scaled(calibration, None, scale), stated)


def _merged(
    calibrated: Sequence[SelfCalibrated],
    reconstructed: tuple[Reconstructed, ...],
    config: Config,
    progress: Progress,
) -> Scan:
    """All captures, with their clouds in one if they are of one corner."""
    if len(reconstructed) == 1 or not config.corner.same:
        return Scan(reconstructed)
    with progress.step("Merging the clouds"):
        cloud, finding = merge(calibrated, [capture.cloud for capture in reconstructed])
    return Scan(reconstructed, cloud, (finding,))


def _ignore(_: Scan) -> None:
    """Does nothing."""
