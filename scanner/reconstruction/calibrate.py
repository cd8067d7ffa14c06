"""Captures → faces → one calibration of the rig; what does not deserve it is refused."""

from dataclasses import replace

import numpy as np

from calib.geometry import FACES, Calibration, Matches
from calib.numerics import Bools, Ints
from calib.plane_segmentation import NO_PLANE, find_faces
from calib.pointcloud import CloudStatistics
from calib.refinement import Shifts
from calib.refusal import RefusalError
from calib.self_calibration import SelfCalibration, self_calibrate, self_calibrate_jointly
from scanner.configuration import Config
from scanner.decoding import SUSPECTED_PX, moved
from scanner.errors import InputError
from scanner.reconstruction.face_masks import label_by_masks
from scanner.results import Findings, Scan

# A calibration whose rays miss each other by more than this, all over the image, is of another rig or of another pose.
_LARGEST_MISS_OF_WIDTH = 0.01
# A calibration from good faces leaves a few hundredths of a pixel; decoders with an uncorrected gamma some tenths.
_LARGEST_MISFIT_PX = 0.5
_LARGEST_MISFIT_OF_NOISE = 2.0
_FEWEST_FOR_A_HOMOGRAPHY = 4
# What is left of a motion may cost the intrinsics so much, one standard deviation.
_MOST_BY_MOTION_PERCENT = 0.5


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
            _refuse_moved(found)
            _label(found, masks if found is scan.newest else None)
    solutions = _solve(scan, config)
    if solutions[0].likely_percent > _MOST_BY_MOTION_PERCENT:
        _refuse_costly(scan)
    for found, solution in zip(scan.captures, solutions, strict=True):
        found.solution, found.matches = _with_doubt(solution), solution.matches
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
            shifts=_shifts_of(scan.newest),
        )
        return (found,)
    return self_calibrate_jointly(
        [found.matches for found in scan.captures],
        *sizes,
        principal_point=point,
        squareness_deg=squareness_deg,
        same=config.corner.same,
        planes=[_planes_of(found) for found in scan.captures],
        shifts=[_shifts_of(found) for found in scan.captures],
    )


def _with_doubt(solution: SelfCalibration) -> SelfCalibration:
    """The same with a note on what nobody can have seen, where there is such a thing."""
    if not solution.possible_percent:
        return solution
    note = (
        "All patterns along one axis came before those along the other, so a motion between them cannot be excluded: "
        f"{SUSPECTED_PX:g} px would cost {solution.possible_percent:.2g} % of the intrinsics. Show a fringe of the "
        "first axis again at the end to exclude it."
    )
    return replace(solution, notes=(*solution.notes, note))


def _shifts_of(found: Findings) -> Shifts:
    motion = found.decoding.motion if found.decoding else None
    return Shifts() if motion is None else motion.shifts


def _refuse_moved(found: Findings) -> None:
    """Raise RefusalError if something moved so far during a capture that single matches cannot be trusted."""
    motion = found.decoding.motion if found.decoding else None
    if motion is not None and motion.is_too_large:
        raise moved(motion)


def _refuse_costly(scan: Scan) -> None:
    """Raise RefusalError for the capture whose motion leaves most in doubt."""
    motions = [found.decoding.motion for found in scan.captures if found.decoding and found.decoding.motion]
    raise moved(max(motions, key=lambda motion: motion.size_px))


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
