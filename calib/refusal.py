"""Why a capture cannot be calibrated, or a thing not be measured."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np


class RefusalError(Exception):
    """No trustworthy calibration can be had from these matches.

    `reason` is one short sentence that names the cause; `advice` says what to do about it.
    """

    refused = "calibration"

    def __init__(self, reason: str, advice: str) -> None:
        super().__init__(f"{reason} {advice}")
        self.reason = reason
        self.advice = advice


class NoMeasurementError(RefusalError):
    """No trustworthy measurement of a thing can be had from a cloud; `reason` and `advice` as above."""

    refused = "measurement"


@dataclass(frozen=True)
class Wording:
    """Names of the first and the second device and of both, of what is `taken`, of the second's pixels; and advice.

    `move`: how to get a better view. `again`: how to get a further one. `unrelated`: what else may be wrong.
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


@contextmanager
def singular_refused(wording: Wording) -> Iterator[None]:
    """Equations without a solution, which follow from matches that are on no three planes, become a RefusalError."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise RefusalError(
            f"The matches determine no corner ({error}): those of a face lie on a line or in a few points, or "
            f"{wording.unrelated}.",
            wording.move,
        ) from error


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
)
