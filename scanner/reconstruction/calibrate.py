"""Captures → faces → one calibration of the rig; what does not deserve it is refused."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.geometry import Calibration, Matches
from calib.numerics import Bools, Ints
from calib.plane_segmentation import NO_PLANE, find_faces
from calib.refusal import TOO_FEW_MATCHES, RefusalError
from calib.self_calibration import SelfCalibration, self_calibrate, self_calibrate_jointly
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.reconstruction.face_masks import label_by_masks, without_margins
from scanner.reconstruction.keystone import on_panel
from scanner.reconstruction.metric_scale import scaled, scaled_by_sheet
from scanner.reconstruction.moved_captures import refuse_costly, refuse_moved, shifts_of, with_motion_findings
from scanner.reconstruction.priors import is_calibration, lenses_of, read_known
from scanner.results import Decoded, SelfCalibrated, Stage, naming

_FEWEST_FOR_A_HOMOGRAPHY = 4


def refuse_impossible(config: Config, count: int) -> None:
    """Raise InputError if the configured method cannot calibrate that many captures."""
    if count > 1 and config.method == "paper":
        raise InputError(
            f"'method: paper' calibrates from one capture, found {count}: use 'method: refined' for several"
        )
    known = next((path for path in config.earlier if is_calibration(path)), None)
    if known is not None and config.method == "paper":
        raise InputError(f"'method: paper' joins nothing with the calibration in {known}: use 'method: refined'")
    if known is not None and config.scale is not None:
        raise InputError(f"{known}: the calibration gives the scale: leave out 'scale', as with --set scale=null")


def label(
    captures: Sequence[Decoded], reached: list[Stage], config: Config, masks: Bools | None = None
) -> list[Decoded]:
    """Label matches with faces, by segmentation, masks or existing labels.

    `masks` (3, H, W) apply to the newest capture. Raises RefusalError; `reached` receives the stage of each capture.
    """
    labelled: list[Decoded] = []
    for number, capture in enumerate(captures):
        with naming(capture, among=len(captures)):
            refuse_moved(capture)
            found = on_panel(_label(capture, config, masks if capture is captures[-1] else None), labelled)
            reached[number] = found
            refuse_few(
                found.matches,
                "Make sure that the projector's light falls on all three faces and capture again, or leave this "
                "capture out.",
            )
        labelled.append(found)
    return labelled


def _label(capture: Decoded, config: Config, masks: Bools | None) -> Decoded:
    if masks is not None:
        return capture.with_matches(label_by_masks(capture.matches, masks), capture.plane)
    if capture.matches.face is not None:
        return capture
    point = config.principal_point(capture.metadata.camera_size)
    known_px = None if point.sigma_px else point.px
    faces = find_faces(capture.matches, capture.metadata.camera_size, capture.metadata.projector_size, known_px)
    found = faces.matches
    if capture.decoding is not None:
        found = without_margins(found, capture.metadata.camera_size, capture.decoding.footprint_px2)
    return capture.with_matches(found, faces.plane)


def calibrate(labelled: Sequence[Decoded], config: Config) -> list[SelfCalibrated]:
    """Matches with faces → a solution for each capture, all of one rig, with its scale.

    Raises RefusalError, InputError.
    """
    solutions = solve(labelled, config)
    newest = solutions[-1]
    refuse_costly(labelled, newest)
    calibration, scaled_solutions = _scaled(labelled, solutions, config)
    return [
        SelfCalibrated(
            capture.with_matches(solution.matches, capture.plane), with_motion_findings(labelled, solution), calibration
        )
        for capture, solution in zip(labelled, scaled_solutions, strict=True)
    ]


def _scaled(
    labelled: Sequence[Decoded], solutions: Sequence[SelfCalibration], config: Config
) -> tuple[Calibration, Sequence[SelfCalibration]]:
    """The calibration with its scale, and the solutions, whose uncertainty may correlate with the scale."""
    newest = solutions[-1]
    if newest.known is not None:
        return newest.metric, solutions
    if config.scale is None or config.scale.charuco is None:
        return scaled(newest.calibration, newest.corner, config.scale), solutions
    charuco = config.scale.charuco
    calibration, uncertainty = scaled_by_sheet(newest.calibration, newest.uncertainty, labelled, charuco)
    if uncertainty is None:
        return calibration, solutions
    return calibration, [
        replace(solution, uncertainty=replace(solution.uncertainty, with_log_baseline=uncertainty.with_log_baseline))
        for solution in solutions
        if solution.uncertainty is not None
    ]


def solve(labelled: Sequence[Decoded], config: Config) -> tuple[SelfCalibration, ...]:
    """A solution for each capture, in baselines. Raises RefusalError, InputError."""
    metadata = labelled[-1].metadata
    sizes, point = (metadata.camera_size, metadata.projector_size), config.principal_point(metadata.camera_size)
    refuse_impossible(config, len(labelled))
    squareness_deg, lenses = config.corner.squareness_deg, lenses_of(config, *sizes)
    known = read_known(config.earlier, metadata.camera_size, metadata.projector_size)
    if len(labelled) == 1 and known is None:
        (alone,) = labelled
        found = self_calibrate(
            alone.matches,
            *sizes,
            principal_point=point,
            method=config.method,
            squareness_deg=squareness_deg,
            lenses=lenses,
            plane=alone.plane,
            shifts=shifts_of(alone),
        )
        return (found,)
    return self_calibrate_jointly(
        [capture.matches for capture in labelled],
        *sizes,
        principal_point=point,
        squareness_deg=squareness_deg,
        lenses=lenses,
        same=config.corner.same,
        planes=[_planes_of(capture) for capture in labelled],
        shifts=[shifts_of(capture) for capture in labelled],
        known=known,
    )


def _planes_of(capture: Decoded) -> Ints:
    return np.full(len(capture.matches), NO_PLANE, np.int32) if capture.plane is None else capture.plane


def refuse_few(matches: Matches, advice: str) -> None:
    """Raise RefusalError, with the advice, where a face has too few matches for a homography."""
    fewest = matches.on_each_face.min()
    if fewest < _FEWEST_FOR_A_HOMOGRAPHY:
        raise RefusalError(
            TOO_FEW_MATCHES,
            f"A face of the corner has {fewest} matches; a homography needs at least "
            f"{_FEWEST_FOR_A_HOMOGRAPHY}, and a good one thousands.",
            advice,
            {"matches": float(fewest), "needed_matches": float(_FEWEST_FOR_A_HOMOGRAPHY)},
        )
