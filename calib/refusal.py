"""Refusals: why a capture cannot be calibrated or an object cannot be measured."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from calib.finding import Datum, Finding, FindingKind, Severity

# Kinds of several estimates.

TOO_FEW_MATCHES = FindingKind(
    "too-few-matches",
    "There are too few matches to find or fit anything in.",
    "Check that both devices see the same part of the scene, light, focus and exposure; of photos, take sharper ones "
    "closer together.",
    ("matches", "needed_matches"),
)
TOO_FEW_PLANES = FindingKind(
    "too-few-planes",
    "Fewer than three planes were found in the matches.",
    "Turn to the corner of a room so that two walls and the floor or ceiling are lit, with little in front of them, "
    "and keep the devices apart.",
    ("planes",),
)
UNDETERMINED_FOCAL = FindingKind(
    "undetermined-focal",
    "The view, or the boards, hardly determine a focal length.",
    "Capture again from where the message suggests, and calibrate all captures together; or state what is known, as a "
    "known principal point.",
    ("sigma_percent",),
)
AMBIGUOUS = FindingKind(
    "ambiguous",
    "Two different answers explain the matches, or the surfaces, almost equally well.",
    "Capture again from another place. In a room, or of a thing, make the sides different.",
    ("camera_focal_px", "other_camera_focal_px", "times_less_likely", "turn_deg"),
)


class RefusalError(Exception):
    """These matches do not determine a trustworthy calibration; `finding` says why, and what to do about it."""

    refused = "calibration"

    def __init__(self, kind: FindingKind, reason: str, advice: str, data: Mapping[str, Datum] | None = None) -> None:
        self.finding = Finding(kind, Severity.REFUSAL, reason, advice, data or {})
        super().__init__(str(self.finding))

    @property
    def reason(self) -> str:
        """One short sentence that names the cause."""
        return self.finding.message

    @property
    def advice(self) -> str:
        """What to do about it."""
        return self.finding.advice

    def about(self, name: str) -> Self:
        """The same refusal, which says what it is about."""
        return type(self)(self.finding.kind, f"{name}: {self.reason}", self.advice, self.finding.data)

    @classmethod
    def of(cls, finding: Finding) -> Self:
        """The refusal for a finding."""
        return cls(finding.kind, finding.message, finding.advice, finding.data)


class NoMeasurementError(RefusalError):
    """Clouds do not determine a trustworthy measurement of an object; `finding` as above."""

    refused = "measurement"


@dataclass(frozen=True)
class Wording:
    """Words for messages: names of the two devices, of both together, of a capture, of the second's pixels; and advice.

    `move`: how to get a better view. `again`: how to get another view. `unrelated`: what else may be wrong.
    `shape`: a likely cause when the images do not fit a square corner, as a sentence to append; '' if there is none.
    """

    first: str
    second: str
    both: str
    taken: str
    pixels: str
    move: str
    again: str
    unrelated: str
    smooth: str
    shape: str


RIG = Wording(
    "the camera",
    "the projector",
    "camera and projector",
    "capture",
    "projector px",
    "Move the rig so that all three faces are seen large and at different slants by both devices, and scan again.",
    "Capture the same corner again from another place with the rig unchanged.",
    "frames and patterns do not belong together",
    "lenses and decoding",
    " If the corner is square, suspect the projector's picture: keystone correction, or a zoom that squeezes it, makes "
    "it what no lens throws. Switch both off, and show the picture pixel for pixel.",
)
PHOTOS = Wording(
    "the first photo",
    "the second photo",
    "the photos' places",
    "pair of photos",
    "px",
    "Take the photos from places a third of the distance to the corner apart, not straight behind one another, with "
    "all three faces large and at different slants in both, at the same zoom.",
    "Add a third photo of the same corner from another place, at the same zoom.",
    "the photos may not be by one camera at one zoom, or one was cropped differently",
    "lens and matching",
    "",
)
