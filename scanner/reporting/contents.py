"""The contents of a report."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.finding import Finding
from calib.geometry import Calibration, Matches
from calib.numerics import Ints
from calib.pointcloud import CloudStatistics, MergedCloud
from calib.self_calibration import SelfCalibration
from scanner.capture import CaptureMetadata
from scanner.measuring import MeasuredScene, measure_scene, one_in_each_cell, sample_cells
from scanner.results import Provenance, Reconstructed, Refused, findings_on


@dataclass(frozen=True)
class CaptureRow:
    """One of several captures that were calibrated together.

    `report`: path of its own report, relative to this one; '' for this one. `residual_px`, the cloud's `statistics` and
    its `calibration` are None if the scan was refused before.
    """

    name: str
    report: str
    matches: int
    residual_px: float | None
    statistics: CloudStatistics | None
    calibration: Calibration | None = None


@dataclass(frozen=True)
class JointCaptures:
    """`count` captures that were calibrated together, and `findings` on that.

    On the newest one's page: `rows`, all of them if there are several, and `merged`, their cloud.
    """

    count: int = 1
    rows: tuple[CaptureRow, ...] = ()
    merged: MergedCloud | None = None
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class ReportInput:
    """The input of a report: the outcome of a capture, and the captures calibrated with it.

    `truth`: of a simulated rig. `files`: names in the result folder. `provenance`: None if nothing is published.
    """

    outcome: Reconstructed | Refused
    truth: Calibration | None = None
    files: tuple[str, ...] = ()
    joint: JointCaptures = JointCaptures()
    provenance: Provenance | None = None

    @property
    def metadata(self) -> CaptureMetadata:
        """The metadata of the capture."""
        return self.outcome.decoded.metadata

    @property
    def matches(self) -> Matches:
        """The matches, with face labels where faces were found."""
        return self.outcome.decoded.matches

    @property
    def reconstructed(self) -> Reconstructed | None:
        """The cloud and how it came about; None after a refusal."""
        return self.outcome if isinstance(self.outcome, Reconstructed) else None

    @property
    def solution(self) -> SelfCalibration | None:
        """The self-calibration of the capture; None after a refusal, or where the calibration was given."""
        return self.reconstructed.solution if self.reconstructed else None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Why it was refused; those on the capture and its calibration, and on the captures that were calibrated
        together.
        """
        refusal = (self.outcome.refusal.finding,) if isinstance(self.outcome, Refused) else ()
        return (*refusal, *findings_on(self.reconstructed or self.outcome.decoded), *self.joint.findings)

    @cached_property
    def sample(self) -> Matches:
        """The matches: all, or one in each cell of `cell_px` of the image."""
        return one_in_each_cell(self.matches, self.metadata.camera_size)

    @cached_property
    def on_faces(self) -> Matches:
        """Those of the `sample` with a face."""
        face = self.sample.face
        return self.sample[np.flatnonzero(face >= 0) if face is not None else slice(0)]

    @cached_property
    def scene(self) -> MeasuredScene | None:
        """Faces, angles, and how well lengths are known, as every page has them; None after a refusal."""
        reconstructed = self.reconstructed
        return (
            measure_scene(self.sample, reconstructed.calibration, reconstructed.uncertainty) if reconstructed else None
        )

    @property
    def cell_px(self) -> int:
        """The side of the square cells in which a page samples matches."""
        return sample_cells(self.metadata.camera_size)[0]

    @cached_property
    def pixels(self) -> Ints:
        """The camera's pixels of the `sample`, as indices into its image, (n,); without those outside of it."""
        width, height = self.metadata.camera_size
        column, row = np.rint(self.sample.camera_px).astype(np.int64).T
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        places: Ints = (row * width + column)[inside]
        return places

    @cached_property
    def in_cloud(self) -> Ints:
        """Those of the `pixels` that have a point in the cloud, (n,)."""
        reconstructed = self.reconstructed
        there = np.isfinite(reconstructed.cloud.points.reshape(-1, 3)[self.pixels, 2]) if reconstructed else slice(0)
        return self.pixels[there]

    @property
    def decoded_share(self) -> float:
        """Matches per camera pixel."""
        width, height = self.metadata.camera_size
        return len(self.matches) / (width * height)
