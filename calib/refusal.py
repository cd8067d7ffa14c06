"""Refusals: why a capture cannot be calibrated or an object cannot be measured."""

from dataclasses import dataclass


class RefusalError(Exception):
    """These matches do not determine a trustworthy calibration.

    `reason` is one short sentence that names the cause; `advice` says what to do about it.
    """

    refused = "calibration"

    def __init__(self, reason: str, advice: str) -> None:
        super().__init__(f"{reason} {advice}")
        self.reason = reason
        self.advice = advice


class NoMeasurementError(RefusalError):
    """Clouds do not determine a trustworthy measurement of an object; `reason` and `advice` as above."""

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
