"""Rig and patterns → the stream that everything else consumes."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from hw.errors import DeviceError
from hw.rig import Frame, Rig
from scanner.patterns import Pattern, draw


@dataclass(frozen=True)
class Stream:
    """Patterns and the frames that show them, one after the other; live, simulated or recorded looks the same.

    `frames` can be walked through once. Sizes are (width, height). `metadata` holds further keys for the recording,
    `account` those that are known only when the frames have been walked through.
    """

    patterns: tuple[Pattern, ...]
    projector_size: tuple[int, int]
    camera_size: tuple[int, int]
    frames: Iterator[tuple[Pattern, Frame]]
    metadata: Mapping[str, object] = field(default_factory=dict)
    account: Callable[[], Mapping[str, object]] = dict


def capture(rig: Rig, patterns: tuple[Pattern, ...]) -> Stream:
    """Project each pattern and grab a frame of it, when the frame is asked for.

    Walking through `frames` raises DeviceError if a device fails or the camera delivers frames of another size.
    """
    frames = _frames(rig, patterns)
    return Stream(patterns, rig.projector.size, rig.camera.size, frames, {"devices": rig.identity}, rig.account)


def _frames(rig: Rig, patterns: tuple[Pattern, ...]) -> Iterator[tuple[Pattern, Frame]]:
    width, height = rig.camera.size
    pictures = (draw(pattern, rig.projector.size) for pattern in patterns)
    for pattern, frame in zip(patterns, rig.photograph(pictures), strict=True):
        if frame.image.shape[:2] != (height, width):
            found = f"{frame.image.shape[1]} × {frame.image.shape[0]}"
            raise DeviceError(f"the camera says that its frames are {width} × {height}, but delivered one of {found}")
        yield pattern, frame
