"""What a report is made from."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.geometry import Calibration, Matches
from calib.numerics import Image, Ints
from calib.pointcloud import NONE, Cloud, MergedCloud
from calib.refusal import RefusalError
from calib.self_calibration import SelfCalibration
from scanner.capture import CaptureFacts
from scanner.decoding import Decoding
from scanner.rendering import cells_over, one_in_cells, places_within

_MOST_ON_FACES = _MOST_IN_CLOUD = 100_000


@dataclass(frozen=True)
class CaptureRow:
    """One of several captures that were calibrated together.

    `report` is where its own report is, relative to this one, '' for this one. `decoder_px`: what the rays of its
    matches miss each other by at random; `points`: in its cloud; None after a refusal.
    """

    name: str
    report: str
    matches: int
    residual_px: float | None
    decoder_px: float | None
    points: int | None


@dataclass(frozen=True)
class ReportInput:
    """Everything that a report may tell; only the capture and its matches are always there.

    `matches` carry face labels where faces were found. `calibration` is the one in use, with its scale: found by
    `solution`, or given by the operator if there is no solution. `refusal` says why there is none. `truth` belongs to a
    simulated rig. `files` are the names in the result folder. A result has a calibration or a refusal, never both.
    `photograph` is the lit scene where nothing was decoded. `together`: how many captures were calibrated together.
    On the newest one's page: `captures`, all of them if there are several, and `merged`, their cloud. `remarks` are
    further notes.

    Raises ValueError if it has both, or neither.
    """

    capture: CaptureFacts
    matches: Matches
    title: str = "Scan"
    decoding: Decoding | None = None
    solution: SelfCalibration | None = None
    calibration: Calibration | None = None
    cloud: Cloud | None = None
    refusal: RefusalError | None = None
    truth: Calibration | None = None
    warnings: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    photograph: Image | None = None
    together: int = 1
    captures: tuple[CaptureRow, ...] = ()
    merged: MergedCloud | None = None
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if (self.calibration is None) == (self.refusal is None):
            raise ValueError("a report needs a calibration or a refusal, and not both")

    @cached_property
    def on_faces(self) -> Ints:
        """Some of the matches with a face, by number (n,): all, or one in each cell of `cell_px` of the image."""
        face = self.matches.face
        if face is None:
            return np.zeros(0, np.int64)
        if np.count_nonzero(face >= 0) <= _MOST_ON_FACES:
            return np.flatnonzero(face >= 0)
        drawn = one_in_cells(self.matches.camera_px, face, 0, *cells_over(self.capture.camera_size, _MOST_ON_FACES))
        return np.asarray(drawn[drawn != NONE])

    @cached_property
    def sample(self) -> Matches:
        """The matches `on_faces`."""
        return self.matches[self.on_faces]

    @property
    def cell_px(self) -> int:
        """Side of square cells that are fine enough for what a page shows of matches."""
        return cells_over(self.capture.camera_size, _MOST_ON_FACES)[0]

    @cached_property
    def in_cloud(self) -> tuple[int, Ints]:
        """How many pixels of the camera have a point, and some of them by number (n,): 100,000 at most, row by row."""
        if self.cloud is None:
            return 0, np.zeros(0, np.int64)
        return places_within(self.cloud.points[..., 2], np.inf, _MOST_IN_CLOUD)

    @property
    def texture(self) -> Image | None:
        """The camera's image of the lit scene."""
        return self.decoding.texture if self.decoding else self.photograph

    @property
    def decoded_share(self) -> float:
        """Matches per camera pixel."""
        width, height = self.capture.camera_size
        return len(self.matches) / (width * height)
