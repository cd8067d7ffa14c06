"""Captures → faces → one calibration of the rig; what does not deserve it is refused.

Hand-drawn faces: three PNG of the size of the camera, nonzero on the face, as in the paper; and faces without the
margin in which the lens mixes them with their surroundings.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from math import ceil, sqrt
from pathlib import Path

import cv2
import numpy as np

from calib.geometry import FACES, NO_FACE, Calibration, Matches, Size
from calib.numerics import Bools, Ints
from calib.plane_segmentation import NO_PLANE, find_faces
from calib.refusal import TOO_FEW_MATCHES, RefusalError
from calib.self_calibration import SelfCalibration, self_calibrate, self_calibrate_jointly
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.io import read_image
from scanner.reconstruction.earlier_captures import refuse_costly, refuse_moved, shifts_of, with_motion_findings
from scanner.reconstruction.keystone import on_panel
from scanner.reconstruction.metric_scale import scaled, scaled_by_sheet
from scanner.reconstruction.priors import is_calibration, lenses_of, read_known
from scanner.results import Decoded, SelfCalibrated, Stage, naming

_FEWEST_FOR_A_HOMOGRAPHY = 4


def read_masks(folder: Path, camera_size: Size) -> Bools:
    """The masks (3, H, W) of the faces 0, 1, 2 in the order of their file names.

    Raises InputError unless the folder holds exactly three PNG of `camera_size`, none empty and no
    two overlapping.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: {'not a folder' if folder.exists() else 'no such folder of masks'}")
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() == ".png" and not path.name.startswith("."))
    if len(paths) != 3:
        names = ", ".join(path.name for path in paths) or "none"
        raise InputError(f"{folder}: expected three PNG, one for each face, found {len(paths)}: {names}")
    masks = np.stack([_read_mask(path, camera_size) for path in paths])
    for (a, first), (b, second) in combinations(enumerate(paths), 2):
        shared = int(np.count_nonzero(masks[a] & masks[b]))
        if shared:
            raise InputError(
                f"{folder}: {first.name} and {second.name} overlap in {shared} pixels: a pixel is on one face only"
            )
    return masks


def _read_mask(path: Path, camera_size: Size) -> Bools:
    image = read_image(path, camera_size)
    if Size.of(image) != camera_size:
        raise InputError(f"{path}: expected the camera's size, {camera_size}, found {Size.of(image)}")
    mask: Bools = (image if image.ndim == 2 else image.max(axis=2)) > 0
    if not mask.any():
        raise InputError(f"{path}: every pixel is zero: the face should be painted in any other colour")
    return mask


def label_by_masks(matches: Matches, masks: Bools) -> Matches:
    """The matches with the face (0, 1, 2) whose mask (3, H, W) covers their camera pixel."""
    _, height, width = masks.shape
    column, row = np.rint(matches.camera_px).astype(np.int64).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    labels = np.full((height, width), NO_FACE, np.int32)
    for label, mask in enumerate(masks):
        labels[mask] = label
    face = np.full(len(matches), NO_FACE, np.int32)
    face[inside] = labels[row[inside], column[inside]]
    return matches.with_faces(face)


# Footprints are Gaussian: beyond two standard deviations lie 2 % of the light.
_SIGMAS = 2.0
# Pixels next to an edge are masked anyway, or are good if the lens is sharp.
_LEAST_PX = 2.0


def without_margins(matches: Matches, camera_size: tuple[int, int], footprint_px2: float) -> Matches:
    """The matches, of which those too close to the face's border for a footprint of this variance lose their face."""
    reach_px = _SIGMAS * sqrt(footprint_px2)
    if reach_px < _LEAST_PX or matches.face is None:
        return matches
    width, height = camera_size
    column, row = np.rint(matches.camera_px).astype(np.int64).T
    size = 2 * ceil(reach_px) + 1
    footprint = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    face = np.full(len(matches), NO_FACE, np.int32)
    for number in FACES:
        on_face = np.zeros((height, width), np.uint8)
        on_face[row[matches.face == number], column[matches.face == number]] = 1
        # A pixel without a match is not a border by itself.
        whole = cv2.morphologyEx(on_face, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        inner = cv2.erode(whole, footprint) > 0
        face[(matches.face == number) & inner[row, column]] = number
    return matches.with_faces(face)


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
            capture_on_panel = on_panel(_label(capture, config, masks if capture is captures[-1] else None), labelled)
            reached[number] = capture_on_panel
            refuse_few(
                capture_on_panel.matches,
                "Make sure that the projector's light falls on all three faces and capture again, or leave this "
                "capture out.",
            )
        labelled.append(capture_on_panel)
    return labelled


def _label(capture: Decoded, config: Config, masks: Bools | None) -> Decoded:
    if masks is not None:
        return capture.with_matches(label_by_masks(capture.matches, masks), capture.plane)
    if capture.matches.face is not None:
        return capture
    point = config.principal_point(capture.metadata.camera_size)
    known_px = None if point.sigma_px else point.px
    faces = find_faces(capture.matches, capture.metadata.camera_size, capture.metadata.projector_size, known_px)
    matches = faces.matches
    if capture.decoding is not None:
        matches = without_margins(matches, capture.metadata.camera_size, capture.decoding.footprint_px2)
    return capture.with_matches(matches, faces.plane)


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
        solution = self_calibrate(
            alone.matches,
            *sizes,
            principal_point=point,
            method=config.method,
            squareness_deg=squareness_deg,
            lenses=lenses,
            plane=alone.plane,
            shifts=shifts_of(alone),
        )
        return (solution,)
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
