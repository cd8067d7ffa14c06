"""Printed boards: what `--board` names, and where its points are."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats
from scanner.errors import InputError

KINDS = {
    "chessboard": "inner corners across and down",
    "charuco": "squares across and down",
    "aprilgrid": "tags across and down",
    "circles": "dots across and down",
    "acircles": "dots in a row, and rows, every other of which is shifted by half",
}
UNIT = "mm"
# The board of --print charuco:A4.
CHARUCO_A4 = (6, 9)
_SHEETS = {"A4": CHARUCO_A4}
TAG_SPACING = 0.3  # gap between tags over their side, as in Kalibr
_MOST = 100
_SQUARES = (1e-3, 1e6)  # in `UNIT`
_MARGIN = 0.8  # margin of the board around the points, in squares


@dataclass(frozen=True)
class Target:
    """A printed target."""

    kind: str
    """One of `KINDS`, where it is said what `columns` and `rows` count."""
    columns: int
    rows: int
    square: float
    """Side of a chessboard's square, of an AprilGrid's tag, or distance between neighbouring dots, in `UNIT`."""

    def __str__(self) -> str:
        return f"{self.kind}:{self.columns}x{self.rows}"

    @property
    def turns(self) -> int:
        """Number of rotations that leave the board unchanged."""
        if self.kind in ("charuco", "aprilgrid"):
            return 1
        if self.kind == "acircles":
            return 2 if self.rows % 2 else 1
        if self.columns == self.rows and (self.kind == "circles" or self.columns % 2):
            return 4
        return 2 if self.kind == "circles" or (self.columns % 2 and self.rows % 2) else 1

    @property
    def points(self) -> Floats:
        """All points of the board (N, 2) relative to its middle, in `UNIT`: row by row, four corners for each tag."""
        if self.kind == "aprilgrid":
            points = self._tag_corners()
        else:
            inner = (self.columns - 1, self.rows - 1) if self.kind == "charuco" else (self.columns, self.rows)
            column, row = (axis.ravel().astype(np.float64) for axis in np.meshgrid(*(np.arange(n) for n in inner)))
            points = np.stack([column, row], axis=1)
            if self.kind == "acircles":
                points = np.stack([column + (row % 2) / 2, row / 2], axis=1)
        centred: Floats = (points - (points.max(axis=0) + points.min(axis=0)) / 2) * self.square
        return centred

    def _tag_corners(self) -> Floats:
        step = 1 + TAG_SPACING
        column, row = (axis.ravel() for axis in np.meshgrid(np.arange(self.columns), np.arange(self.rows)))
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
        places: Floats = step * np.stack([column, row], axis=1)[:, None] + corners
        return places.reshape(-1, 2)

    @property
    def margin(self) -> float:
        """The distance around each point to which the board certainly extends, in `UNIT`."""
        share = {"aprilgrid": 0.1, "circles": 0.4, "acircles": 0.25}.get(self.kind, _MARGIN)
        return share * self.square

    @property
    def reach(self) -> float:
        """Half its longer side, in `UNIT`."""
        return float(np.abs(self.points).max()) + self.margin


def parse_target(text: str, square: float) -> Target:
    """'chessboard:9x7' → the board. Raises InputError, also for squares that no board has."""
    least, most = _SQUARES
    if not least <= square <= most:
        raise InputError(f"--square: expected {least:g} to {most:g} {UNIT}, found {square:g} {UNIT}")
    kind, _, counts = text.partition(":")
    if kind not in KINDS:
        raise InputError(f"--board {text}: expected one of {', '.join(KINDS)}, as in chessboard:9x7")
    if kind == "charuco" and counts.upper() in _SHEETS:
        return Target(kind, *_SHEETS[counts.upper()], square)
    columns, _, rows = counts.lower().replace("×", "x").partition("x")
    if not all(count.isdecimal() and 2 <= int(count) <= _MOST for count in (columns, rows)):
        raise InputError(f"--board {text}: expected two numbers, {KINDS[kind]}, as in {kind}:9x7")
    target = Target(kind, int(columns), int(rows), square)
    fewest = 3 if kind in ("chessboard", "charuco") else 2
    if min(target.columns, target.rows) < fewest:
        raise InputError(f"--board {text}: expected {fewest} or more {KINDS[kind]}")
    return target
