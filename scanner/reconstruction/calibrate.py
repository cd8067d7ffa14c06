"""Captures → faces → one calibration of the rig; what does not deserve it is refused."""

import numpy as np

from calib.geometry import FACES, Calibration, Matches
from calib.numerics import Bools, Ints
from calib.plane_segmentation import NO_PLANE, find_faces
from calib.pointcloud import CloudStatistics
from calib.refusal import RefusalError
from calib.self_calibration import SelfCalibration, self_calibrate, self_calibrate_jointly
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.reconstruction.face_masks import label_by_masks
from scanner.results import Findings, Scan

# A calibration whose rays miss each other by more than this, all over the image, is of another rig or of another pose.
_LARGEST_MISS_OF_WIDTH = 0.01
# A calibration from good faces leaves a few hundredths of a pixel; decoders with an uncorrected gamma some tenths.
_LARGEST_MISFIT_PX = 0.5
_LARGEST_MISFIT_OF_NOISE = 2.0
_FEWEST_FOR_A_HOMOGRAPHY = 4


def refuse_impossible(config: Config, count: int) -> None:
    """Raise InputError if the configured method cannot calibrate that many captures."""
    if count > 1 and config.method == "paper":
        raise InputError(
            f"'method: paper' calibrates from one capture, found {count}: use 'method: refined' for several"
        )


def self_calibration(scan: Scan, config: Config, masks: Bools | None = None) -> Calibration:
    """Matches → faces (found, drawn by hand, or labelled already) → a solution for each capture, all of one rig.

    `masks` (3, H, W) are of the newest capture. Raises RefusalError, InputError.
    """
    refuse_impossible(config, len(scan.captures))
    for found in scan.captures:
        with scan.naming(found):
            _label(found, masks if found is scan.newest else None)
    solutions = _solve(scan, config)
    for found, solution in zip(scan.captures, solutions, strict=True):
        found.solution, found.matches = solution, solution.matches
    return solutions[-1].calibration


def _solve(scan: Scan, config: Config) -> tuple[SelfCalibration, ...]:
    facts = scan.newest.facts
    sizes, point = (facts.camera_size, facts.projector_size), config.principal_point(facts.camera_size)
    squareness_deg = config.corner.squareness_deg
    if len(scan.captures) == 1:
        found = self_calibrate(
            scan.newest.matches,
            *sizes,
            principal_point=point,
            method=config.method,
            squareness_deg=squareness_deg,
            plane=scan.newest.plane,
        )
        return (found,)
    return self_calibrate_jointly(
        [found.matches for found in scan.captures],
        *sizes,
        principal_point=point,
        squareness_deg=squareness_deg,
        same=config.corner.same,
        planes=[_planes_of(found) for found in scan.captures],
    )


def _planes_of(found: Findings) -> Ints:
    return np.full(len(found.matches), NO_PLANE, np.int32) if found.plane is None else found.plane


def _label(found: Findings, masks: Bools | None) -> None:
    if masks is not None:
        found.matches = label_by_masks(found.matches, masks)
    elif found.matches.face is None:
        facts = found.facts
        faces = find_faces(found.matches, facts.camera_size, facts.projector_size)
        found.matches, found.plane = faces.matches, faces.plane
    refuse_few(
        found.matches,
        "See that the projector's light falls on all three faces, and capture again; or leave this capture out.",
    )


def refuse_few(matches: Matches, advice: str) -> None:
    """Raise RefusalError, with the advice, where a face has too few matches for a homography."""
    face = matches.face
    assert face is not None
    counts = np.bincount(face[face >= 0], minlength=len(FACES))
    if counts.min() < _FEWEST_FOR_A_HOMOGRAPHY:
        raise RefusalError(
            f"A face of the corner has {counts.min()} matches; a homography needs at least "
            f"{_FEWEST_FOR_A_HOMOGRAPHY}, and a good one thousands.",
            advice,
        )


def refuse_foreign(statistics: CloudStatistics, projector_size: tuple[int, int]) -> None:
    """Raise RefusalError if, by a given calibration, no rays meet, or all miss by more than lenses explain."""
    advice = "Check that it belongs to this rig, and that nothing has moved since it was made."
    if statistics.kept == 0:
        raise RefusalError("The calibration puts no point in front of both camera and projector.", advice)
    if statistics.calibration_px > _LARGEST_MISS_OF_WIDTH * projector_size[0]:
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
