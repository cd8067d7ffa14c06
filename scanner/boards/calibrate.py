"""Folders on the command line → captures of a board → views of it → a calibration."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.boards import FEWEST_VIEWS, Board, BoardCalibration, BoardView, calibrate_boards
from calib.estimation import into_cells
from calib.finding import Finding, FindingKind, Severity
from calib.geometry import SQUARE_PIXELS, Matches, PixelGrid, Size, TooFewMatchesError
from calib.numerics import Image
from scanner.acquisition import decode
from scanner.capture import CAPTURE_FILE, Recording, open_capture
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.io import given_path, refuse_other_sizes
from scanner.quantities import shown_unit
from scanner.reconstruction import lenses_of
from scanner.results import Decoded
from scanner.targets import UNIT, Detected, NotFoundError, Target, detect, on_board
from scanner.ui import Progress

_FEWEST_MATCHES = 300
# Plausible ranges of a board's longer side, its distance, and the baseline: values outside suggest a wrong unit.
_PLAUSIBLE_SIDE_MM, _PLAUSIBLE_AWAY_MM, _PLAUSIBLE_BASELINE_MM = (80.0, 1500.0), (120.0, 20_000.0), (30.0, 5_000.0)

NO_BOARD = FindingKind(
    "no-board",
    "A capture is not used, because it does not decode or does not show the board.",
    "Light the whole board with the projector, and let the camera see all of it.",
)
SCALE_OF_SQUARE = FindingKind(
    "scale-of-square",
    "The lengths that follow from the stated size of the board's squares.",
    data=("board_mm", "baseline_mm", "nearest_mm", "farthest_mm"),
)
UNLIKELY_SCALE = FindingKind(
    "unlikely-scale",
    "The lengths that follow from the stated size of the board's squares are unlikely. The intrinsics do not depend on "
    "it.",
    "Measure the square again, and mind the unit.",
    ("board_mm", "baseline_mm", "nearest_mm", "farthest_mm"),
)


@dataclass(frozen=True)
class BoardCapture:
    """A capture in which the board was found: its `texture` under white light, and the `view` of the board."""

    texture: Image
    view: BoardView

    @property
    def name(self) -> str:
        """Which capture it is, in messages."""
        return self.view.name


@dataclass(frozen=True)
class Missing:
    """A capture in which it was not, and why."""

    name: str
    why: str


@dataclass(frozen=True)
class FromBoards:
    """The result of calibrating from captures of a board."""

    target: Target
    captures: tuple[BoardCapture, ...]
    """Those that show the board."""
    missing: tuple[Missing, ...]
    """Those without it, and why."""
    calibrated: BoardCalibration

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Those on captures without the board, on the calibration, and on its scale."""
        missing = (
            Finding(NO_BOARD, Severity.NOTE, f"{capture.name} is not used: {capture.why}.") for capture in self.missing
        )
        return (*missing, *self.calibrated.findings, _on_scale(self))


def calibrate_captures(
    recordings: Sequence[Recording], target: Target, progress: Progress, config: Config | None = None
) -> FromBoards:
    """Decode, find the board, calibrate; `config` gives priors on the lenses.

    Raises InputError if no capture shows the board, RefusalError.
    """
    looked = [
        _find_in(recording, name, target, progress)
        for name, recording in zip(_names(recordings), recordings, strict=True)
    ]
    sizes = recordings[0].camera_size, recordings[0].projector_size
    return calibrate_board_captures(looked, target, *sizes, progress, config)


def calibrate_board_captures(
    looked: Sequence[BoardCapture | Missing],
    target: Target,
    camera_size: Size,
    projector_size: Size,
    progress: Progress,
    config: Config | None = None,
) -> FromBoards:
    """Calibrate from captures that were looked at. Raises InputError if none has the board, RefusalError."""
    captures = [look for look in looked if isinstance(look, BoardCapture)]
    missing = [look for look in looked if isinstance(look, Missing)]
    if not captures:
        reasons = "".join(f"\n  {capture.name}: {capture.why}" for capture in missing)
        raise InputError(f"--board {target}: no capture shows such a board:{reasons}")
    if missing and len(captures) < FEWEST_VIEWS:
        reasons = "".join(f"\n  {capture.name}: {capture.why}" for capture in missing)
        raise InputError(f"expected the board in at least three captures, found it in {len(captures)}:{reasons}")
    with progress.step("Calibrating"):
        calibrated = calibrate_boards(
            [capture.view for capture in captures],
            camera_size,
            projector_size,
            Board(target.reach, target.turns, UNIT),
            lenses=lenses_of(config or Config(), camera_size, projector_size),
        )
    return FromBoards(target, tuple(captures), tuple(missing), calibrated)


def _names(recordings: Sequence[Recording]) -> list[str]:
    """Return the shortest distinct names of the folders."""
    parts = [given_path(recording.folder).parts for recording in recordings]
    longest = max(len(part) for part in parts)
    names = (["/".join(part[-length:]) for part in parts] for length in range(1, longest + 1))
    return next(candidate for candidate in names if len(set(candidate)) == len(candidate))


def _find_in(recording: Recording, name: str, target: Target, progress: Progress) -> BoardCapture | Missing:
    try:
        (decoded,) = decode([recording.stream()], progress, f"Decoding {name}", [name])
    except InputError as error:
        # A bad capture among good ones is left out and named, like one without a board.
        return Missing(name, str(error))
    return find_board(decoded, target, progress)


def find_board(decoded: Decoded, target: Target, progress: Progress) -> BoardCapture | Missing:
    """Find the board in a capture."""
    if decoded.texture is None:
        return Missing(decoded.name, "it has no picture of the lit scene to find a board in")
    try:
        with progress.step("Finding the board"):
            detected = detect(decoded.texture, target)
        return BoardCapture(
            decoded.texture, view_of(decoded.name, detected, decoded.matches, target, decoded.metadata.camera_size)
        )
    except NotFoundError as error:
        return Missing(decoded.name, str(error))


def view_of(name: str, detected: Detected, matches: Matches, target: Target, size: Size) -> BoardView:
    """The board with the matches on it. Raises NotFoundError for too few of them."""
    column, row = np.rint(matches.camera_px).astype(np.int64).clip(0, np.array(size) - 1).T
    lit = matches[on_board(detected, target, size)[row, column]]
    if len(lit) < _FEWEST_MATCHES:
        raise NotFoundError(f"the board has {len(lit)} matches only: is it lit by the projector?")
    try:
        cells = into_cells(lit.with_faces(np.zeros(len(lit), np.int32)), (0,))
    except TooFewMatchesError as error:
        raise NotFoundError(f"the board's matches are no plane: {error}") from error
    return BoardView(name, detected.points, detected.pixels, cells)


def _on_scale(result: FromBoards) -> Finding:
    """The lengths that follow from the square's size, and whether they are plausible."""
    distances = [board.pose.distance for board in result.calibrated.estimate.state.boards]
    nearest, farthest, baseline = min(distances), max(distances), result.calibrated.calibration.baseline
    side, number = 2 * result.target.reach, shown_unit(UNIT).number
    message = (
        f"All lengths scale with the square: with {result.target.square:g} {UNIT}, the board is {number(side)} {UNIT} "
        f"long, camera and projector are {number(baseline)} {UNIT} apart and the boards were {number(nearest)} to "
        f"{number(farthest)} {UNIT} away."
    )
    plausible = (
        (side, _PLAUSIBLE_SIDE_MM),
        (nearest, _PLAUSIBLE_AWAY_MM),
        (farthest, _PLAUSIBLE_AWAY_MM),
        (baseline, _PLAUSIBLE_BASELINE_MM),
    )
    lengths = {"board_mm": side, "baseline_mm": baseline, "nearest_mm": nearest, "farthest_mm": farthest}
    if all(low < length < high for length, (low, high) in plausible):
        return Finding(SCALE_OF_SQUARE, Severity.NOTE, message, data=lengths)
    message += " That is unlikely: measure the square again, and mind the unit. The intrinsics do not depend on it."
    return Finding(UNLIKELY_SCALE, Severity.NOTE, message, data=lengths)


def read_folders(folders: Sequence[Path], grid: PixelGrid = SQUARE_PIXELS) -> list[Recording]:
    """The captures in folders, or in folders of those, in the order of their names. Raises InputError.

    They come from one unchanged rig, so their sizes are the same, and each is given once. `grid`: its projector's
    pixels.
    """
    recordings: list[Recording] = []
    for folder in folders:
        recordings += [open_capture(place).in_square_pixels(grid) for place in _captures_in(folder)]
    places = [recording.folder.resolve() for recording in recordings]
    for i, place in enumerate(places):
        if place in places[:i]:
            raise InputError(f"{recordings[i].folder}: given twice; a board counted twice would make sigmas too small")
    first, why = recordings[0], ": captures that are calibrated together come from one unchanged rig"
    for later in recordings[1:]:
        sizes, expected = ((capture.camera_size, capture.projector_size) for capture in (later, first))
        refuse_other_sizes(later.folder, sizes, expected, f"that of {first.folder}", why)
    return recordings


def _captures_in(folder: Path) -> list[Path]:
    if not (folder / CAPTURE_FILE).exists() and folder.is_dir():
        inner = sorted(place.parent for place in folder.glob(f"*/{CAPTURE_FILE}"))
        if inner and not (folder / "capture" / CAPTURE_FILE).exists():
            return inner
    return [folder]
