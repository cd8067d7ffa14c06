"""The stages of a capture: decoded → calibrated → reconstructed, or refused on the way. All are immutable.

What is captured is `scanner.capture.Stream`; its frames are gone once they are decoded, and `CaptureMetadata` stays.
Each stage holds the one before it. What all captures of a scan have in common is in `Scan`.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnostics import Uncertainty
from calib.estimation import Shift
from calib.finding import Finding
from calib.geometry import Calibration, Corner, Matches
from calib.numerics import Floats, Image, Ints
from calib.pointcloud import Cloud, MergedCloud
from calib.refusal import RefusalError
from calib.self_calibration import SelfCalibration
from scanner.capture import CaptureMetadata
from scanner.decoding import SMOOTH_PX, Decoding
from scanner.patterns import Axis


@dataclass(frozen=True)
class GivenMatches:
    """Matches of an earlier decoding. Other decoders are assumed to have the smooth errors of this one."""

    photograph: Image | None = None
    """The lit scene, None without a picture."""
    smooth_px: float = SMOOTH_PX
    """As of `Decoding`."""
    only_axis: Axis | None = None
    """As of `Decoding`."""


@dataclass(frozen=True)
class Panel:
    """`homography` (3, 3): what took the projector's picture to the pixels of its panel, which it may err by `shifts`,
    fields of one standard deviation.
    """

    homography: Floats
    shifts: tuple[Shift, ...] = ()


AS_SHOWN = Panel(np.eye(3))


@dataclass(frozen=True)
class Decoded:
    """A capture as matches, with face labels once these are known."""

    metadata: CaptureMetadata
    matches: Matches
    origin: Decoding | GivenMatches
    """Source of the matches."""
    name: str = ""
    """Of the capture in messages."""
    plane: Ints | None = None
    """The plane of each match, as of `Faces`, if the faces were found and not given, (N,)."""
    panel: Panel | None = None
    """The meaning of the projector's pixels; None until it is known."""

    @property
    def decoding(self) -> Decoding | None:
        """The decoder's findings; None where the matches were given."""
        return self.origin if isinstance(self.origin, Decoding) else None

    @property
    def texture(self) -> Image | None:
        """The camera's image of the lit scene."""
        return self.origin.texture if isinstance(self.origin, Decoding) else self.origin.photograph

    @property
    def only_axis(self) -> Axis | None:
        """The only axis along which the projector's coordinate was measured, if so."""
        return self.origin.only_axis

    def with_findings(self, *findings: Finding) -> "Decoded":
        """The same capture with findings before all those of the decoder."""
        if self.decoding is None or not findings:
            return self
        return replace(self, origin=replace(self.decoding, findings=(*findings, *self.decoding.findings)))

    def with_matches(self, matches: Matches, plane: Ints | None) -> "Decoded":
        """The same capture, of whose matches more is known."""
        return replace(self, matches=matches, plane=plane)


@dataclass(frozen=True)
class SelfCalibrated:
    """`solution` is in baselines; `calibration` is the same with its scale."""

    decoded: Decoded
    solution: SelfCalibration
    calibration: Calibration

    @property
    def corner(self) -> Corner:
        """The corner in the camera's frame and the calibration's unit."""
        corner = self.solution.corner
        return Corner(corner.vertex * self.calibration.baseline, corner.legs)


@dataclass(frozen=True)
class GivenCalibration:
    """The operator gave the calibration: no face was looked for. `stated`: what its file says of its covariance."""

    decoded: Decoded
    calibration: Calibration
    stated: Uncertainty | None = None


Calibrated = SelfCalibrated | GivenCalibration


@dataclass(frozen=True)
class Reconstructed:
    """The last stage."""

    calibrated: Calibrated
    cloud: Cloud

    @property
    def decoded(self) -> Decoded:
        """The capture as matches."""
        return self.calibrated.decoded

    @property
    def calibration(self) -> Calibration:
        """The one in use, with its scale."""
        return self.calibrated.calibration

    @property
    def solution(self) -> SelfCalibration | None:
        """What calibrated it; None where the calibration was given."""
        return solution_of(self)

    @property
    def uncertainty(self) -> Uncertainty | None:
        """The uncertainty of the calibration in use; None where unknown."""
        known = self.calibrated
        return known.solution.uncertainty if isinstance(known, SelfCalibrated) else known.stated


Stage = Decoded | SelfCalibrated | GivenCalibration | Reconstructed


@dataclass(frozen=True)
class Refused:
    """A capture of a refused scan, at the stage that it `reached`."""

    reached: Stage
    refusal: RefusalError

    @property
    def decoded(self) -> Decoded:
        """The capture as matches."""
        return decoded_of(self.reached)


@dataclass(frozen=True)
class Scan:
    """Captures of one unchanged rig, oldest first; mostly it is only one."""

    captures: tuple[Reconstructed, ...]
    merged: MergedCloud | None = None
    """Their clouds in one, where the relation of several captures is certain."""
    own_findings: tuple[Finding, ...] = ()
    """Those on all captures together."""

    @property
    def newest(self) -> Reconstructed:
        """The capture that the result is about; the others help to calibrate it."""
        return self.captures[-1]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Those on the newest capture, and on all together."""
        return (*findings_on(self.newest), *self.own_findings)


def decoded_of(stage: Stage) -> Decoded:
    """The matches of a capture at any stage."""
    return stage if isinstance(stage, Decoded) else stage.decoded


def solution_of(stage: Stage) -> SelfCalibration | None:
    """Return the self-calibration of the capture; None without one, or if the calibration was given."""
    calibrated = stage.calibrated if isinstance(stage, Reconstructed) else stage
    return calibrated.solution if isinstance(calibrated, SelfCalibrated) else None


def findings_on(stage: Stage) -> tuple[Finding, ...]:
    """Return the findings on the decoding and the calibration of a capture."""
    decoding, solution = decoded_of(stage).decoding, solution_of(stage)
    return (*(decoding.findings if decoding else ()), *(solution.findings if solution else ()))


def titles_of(captures: Sequence[Decoded]) -> tuple[str, ...]:
    """The captures' numbers, as notes have them, and where they come from if they were not taken just now."""
    if captures[-1].metadata.photos:
        return tuple(capture.name for capture in captures)
    numbers = [f"Capture {number}" for number in range(1, len(captures) + 1)]
    return tuple(
        number if capture.name in ("", number) else f"{number}: {capture.name}"
        for number, capture in zip(numbers, captures, strict=True)
    )


@contextmanager
def naming(capture: Decoded, *, among: int) -> Iterator[None]:
    """A RefusalError in the block says which of several captures it is about."""
    try:
        yield
    except RefusalError as refusal:
        if among == 1:
            raise
        raise refusal.about(capture.name) from refusal
