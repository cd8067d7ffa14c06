"""Captures that exist already: matches files and result folders, read and checked before they are calibrated.

Captures during which something moved: refused, or with what may be left of it in their sigmas and findings.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.estimation import Shifts
from calib.finding import Finding, FindingKind, Severity
from calib.geometry import NO_FACE, Size
from calib.numerics import Floats, Ints
from calib.self_calibration import SelfCalibration
from scanner.capture import CAPTURE_FILE, CaptureMetadata, open_capture
from scanner.decoding import SUSPECTED_PX, UNSEEN_MOTION, MotionVerdict, moved, smooth_error_px
from scanner.errors import InputError
from scanner.io import MATCHES_FILE, read_calibration, read_matches, read_only_axis, read_planes, refuse_one_axis
from scanner.patterns import Phase
from scanner.reconstruction.priors import is_calibration, read_known
from scanner.results import CALIBRATION_FILE, CAPTURE_FOLDER, CAPTURES_FOLDER, Decoded, GivenMatches

# Largest effect of a remaining motion on the intrinsics, one standard deviation; or as much as their uncertainty at
# rest.
_MOST_PERCENT = 0.5

REMAINING_MOTION = FindingKind(
    "remaining-motion",
    "A motion was corrected, and what may remain of it matters for the intrinsics; it is part of their sigmas.",
    "Fasten what moved, and capture again.",
    ("intrinsics_percent", "at_rest_percent"),
)
# Undistorted or extrapolated pixels may lie slightly outside the image.
_MARGIN_OF_SIZE = 0.1


def refuse_moved(capture: Decoded) -> None:
    """Raise RefusalError if something moved so far during a capture that its matches cannot be trusted."""
    motion = capture.decoding.motion if capture.decoding else None
    if motion is not None and motion.verdict is MotionVerdict.TOO_LARGE:
        raise moved(motion)


def refuse_costly(captures: Sequence[Decoded], solution: SelfCalibration) -> None:
    """Raise RefusalError for the capture with the largest motion, if its effect on the solution is too large."""
    if solution.likely_percent > max(_MOST_PERCENT, solution.at_rest_percent):
        motions = [capture.decoding.motion for capture in captures if capture.decoding and capture.decoding.motion]
        raise moved(max(motions, key=lambda motion: motion.size_px))


def shifts_of(capture: Decoded) -> Shifts:
    """Return the shifts that all matches of a capture may have in common."""
    motion = capture.decoding.motion if capture.decoding else None
    of_motion = Shifts() if motion is None else motion.shifts
    of_panel = capture.panel.shifts if capture.panel else ()
    of_decoding = capture.decoding.shifts if capture.decoding else ()
    return replace(of_motion, decoding=(*of_panel, *of_decoding), smooth_px=capture.origin.smooth_px)


def with_motion_findings(captures: Sequence[Decoded], solution: SelfCalibration) -> SelfCalibration:
    """Add findings on the loss of accuracy by motion, and on motion that the capture cannot reveal, where either
    applies.
    """
    if solution.likely_percent > _MOST_PERCENT:
        cost = Finding(
            REMAINING_MOTION,
            Severity.NOTE,
            f"The remaining motion may change the intrinsics by {solution.likely_percent:.2g} %; at rest, this view "
            f"determines them to {solution.at_rest_percent:.2g} %. Both are part of their sigmas.",
            data={"intrinsics_percent": solution.likely_percent, "at_rest_percent": solution.at_rest_percent},
        )
        solution = replace(solution, findings=(*solution.findings, cost))
    motions = [capture.decoding.motion for capture in captures if capture.decoding]
    if not any(motion is not None and motion.is_blind for motion in motions):
        return solution
    unseen = Finding(
        UNSEEN_MOTION,
        Severity.NOTE,
        "All patterns along one axis came before those along the other, so the frames cannot show whether a device "
        f"turned in between: {SUSPECTED_PX:g} px would change the intrinsics by {solution.possible_percent:.2g} %, "
        "which is part of their sigmas; a larger motion is not.",
        UNSEEN_MOTION.remedy,
        {"suspected_px": SUSPECTED_PX, "intrinsics_percent": solution.possible_percent},
    )
    return replace(solution, findings=(*solution.findings, unseen))


def read_captures(
    paths: Sequence[Path],
    camera_size: Size,
    projector_size: Size,
    *,
    one_axis: bool = False,
    decode: Callable[[Path], Decoded] | None = None,
) -> list[Decoded]:
    """The captures in matches files and result folders; a result of several captures stands for all of them.

    `decode`: how recordings are read, which are refused without it.

    A calibration among them, such as of boards, is no capture, and is only checked: `read_known`. `one_axis`: accept
    matches with one coordinate derived from a calibration. Raises InputError, naming the file, if one is damaged,
    belongs to images of another size, or is given twice.
    """
    read_known(paths, camera_size, projector_size)
    captures: list[Decoded] = []
    for path in (path for path in paths if not is_calibration(path)):
        for place in _places(path):
            if decode is not None and _is_recording(place):
                capture = decode(place)
            else:
                capture = _read(place, camera_size, projector_size, one_axis=one_axis)
            for earlier in captures:
                _refuse_same(capture, earlier)
            captures.append(capture)
    return captures


def _places(path: Path) -> Iterator[Path]:
    """Return the locations of the captures in a matches file or a result folder, oldest first."""
    if (path / CAPTURES_FOLDER).is_dir():
        inner = [place for place in (path / CAPTURES_FOLDER).iterdir() if place.name.isdecimal()]
        yield from sorted(inner, key=lambda place: int(place.name))
        if not (path / MATCHES_FILE).is_file():
            return  # an interrupted scan: only its finished captures exist
    yield path


def _is_recording(path: Path) -> bool:
    return (path / CAPTURE_FILE).is_file() and not (path / MATCHES_FILE).is_file()


def _read(place: Path, camera_size: Size, projector_size: Size, *, one_axis: bool) -> Decoded:
    if _is_recording(place):
        raise InputError(f"{place}: expected matches, found a recording: make a result of it first, with scan replay")
    matches = read_matches(place)
    if not one_axis:
        refuse_one_axis(place)
    origin = GivenMatches()
    if place.is_dir():
        origin = _check_result(place, camera_size, projector_size)
    _check_inside(place, "camera", matches.camera_px, camera_size)
    _check_inside(place, "projector", matches.projector_px, projector_size)
    matches = replace(matches, face=_three_faces(place, matches.face))
    metadata = CaptureMetadata(camera_size, projector_size, identity={"matches": str(place)})
    origin = replace(origin, only_axis=read_only_axis(place))
    return Decoded(metadata, matches, origin, str(place), read_planes(place))


def _check_result(folder: Path, camera_size: Size, projector_size: Size) -> GivenMatches:
    """Compare the sizes that a result states with those expected; what its recording, if it has one, says of it."""
    if (folder / CALIBRATION_FILE).is_file():
        calibration = read_calibration(folder / CALIBRATION_FILE)
        for name, device, expected in (
            ("camera", calibration.camera, camera_size),
            ("projector", calibration.projector, projector_size),
        ):
            _check_size(folder, name, device.size, expected)
    if not (folder / CAPTURE_FOLDER / CAPTURE_FILE).is_file():
        return GivenMatches()
    recording = open_capture(folder / CAPTURE_FOLDER)
    if not (folder / CALIBRATION_FILE).is_file():
        _check_size(folder, "camera", recording.camera_size, camera_size)
        _check_size(folder, "projector", recording.projector_size, projector_size)
    fringes = (pattern for pattern in recording.patterns if isinstance(pattern, Phase))
    return GivenMatches(recording.white(), smooth_error_px(fringes))


def _check_size(folder: Path, name: str, actual: Size, expected: Size) -> None:
    if actual != expected:
        raise InputError(
            f"{folder}: its {name} is {actual}, but {expected} is expected: captures "
            "that are calibrated together come from one unchanged rig"
        )


def _refuse_same(capture: Decoded, earlier: Decoded) -> None:
    a, b = capture.matches, earlier.matches
    if np.array_equal(a.camera_px, b.camera_px) and np.array_equal(a.projector_px, b.projector_px):
        raise InputError(
            f"{capture.name}: holds the same matches as {earlier.name}: a capture counted twice would make sigmas too "
            "small"
        )


def _check_inside(path: Path, device: str, pixels: Floats, size: Size) -> None:
    for axis, (name, length) in enumerate(zip(("width", "height"), size, strict=True)):
        low, high = pixels[:, axis].min(), pixels[:, axis].max()
        if low < -_MARGIN_OF_SIZE * length or high > (1 + _MARGIN_OF_SIZE) * length:
            raise InputError(
                f"{path}: {device}_px runs from {low:.0f} to {high:.0f} in {'xy'[axis]}, but the configuration's "
                f"{device}.{name} is {length}"
            )


def _three_faces(path: Path, face: Ints | None) -> Ints | None:
    """Labels 0, 1, 2 in the order of the file's labels; None if no match has one, so that faces have to be found."""
    if face is None or np.all(face == NO_FACE):
        return None
    labels = np.unique(face[face != NO_FACE])
    if len(labels) != 3:
        raise InputError(f"{path}: 'face' must label three faces, found {len(labels)}: {', '.join(map(str, labels))}")
    return np.where(face == NO_FACE, NO_FACE, np.searchsorted(labels, face)).astype(np.int32)
