"""What the two devices, and the advice to a person who has to try again, are called in messages."""

from dataclasses import dataclass


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
