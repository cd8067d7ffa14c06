"""Rig and patterns → the stream that everything else consumes."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import cycle

from calib.arrays import Image
from hw.errors import DeviceError
from hw.rig import ExposureControl, Frame, Rig
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


def capture(rig: Rig, patterns: tuple[Pattern, ...], exposures_us: tuple[float, ...] = ()) -> Stream:
    """Project each pattern and grab a frame of it, or one at each of `exposures_us`, when the frame is asked for.

    Raises DeviceError if the camera cannot change its exposure. Walking through `frames` raises DeviceError if a device
    fails or the camera delivers frames of another size.
    """
    if exposures_us and not isinstance(rig.camera, ExposureControl):
        raise DeviceError("this camera's exposure cannot be changed during a capture; leave sequence.exposures_us out")
    repeated = tuple(pattern for pattern in patterns for _ in exposures_us or (None,))
    frames = _frames(rig, repeated, exposures_us)
    return Stream(repeated, rig.projector.size, rig.camera.size, frames, {"devices": rig.identity}, rig.account)


def _frames(
    rig: Rig, patterns: tuple[Pattern, ...], exposures_us: tuple[float, ...]
) -> Iterator[tuple[Pattern, Frame]]:
    width, height = rig.camera.size
    pictures = (draw(pattern, rig.projector.size) for pattern in patterns)
    taken = _bracketed(rig, pictures, exposures_us) if exposures_us else rig.photograph(pictures)
    for pattern, frame in zip(patterns, taken, strict=True):
        if frame.image.shape[:2] != (height, width):
            found = f"{frame.image.shape[1]} × {frame.image.shape[0]}"
            raise DeviceError(f"the camera says that its frames are {width} × {height}, but delivered one of {found}")
        yield pattern, frame


def _bracketed(rig: Rig, pictures: Iterator[Image], exposures_us: tuple[float, ...]) -> Iterator[Frame]:
    """A frame of each picture, the exposures taking turns; each picture comes once for each exposure."""
    for picture, exposure_us in zip(pictures, cycle(exposures_us), strict=False):
        assert isinstance(rig.camera, ExposureControl)
        rig.camera.expose_for(exposure_us)
        rig.projector.show(picture)
        yield rig.camera.grab()
