"""Rig and patterns → the stream that everything else consumes."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from hw.errors import DeviceError
from hw.rig import ExposureControl, Frame, Rig
from scanner.patterns import Pattern, draw


@dataclass(frozen=True)
class Stream:
    """Patterns and the frames that show them, one after the other; live, simulated or recorded looks the same.

    `frames` can be walked through once. Sizes are (width, height). `metadata` holds further keys for the recording.
    """

    patterns: tuple[Pattern, ...]
    projector_size: tuple[int, int]
    camera_size: tuple[int, int]
    frames: Iterator[tuple[Pattern, Frame]]
    metadata: Mapping[str, object] = field(default_factory=dict)


def capture(rig: Rig, patterns: tuple[Pattern, ...], exposures_us: tuple[float, ...] = ()) -> Stream:
    """Project each pattern and grab a frame of it, or one at each of `exposures_us`, when the frame is asked for.

    Raises DeviceError if the camera cannot change its exposure. Walking through `frames` raises DeviceError if a device
    fails or the camera delivers frames of another size.
    """
    if exposures_us and not isinstance(rig.camera, ExposureControl):
        raise DeviceError("this camera's exposure cannot be changed during a capture; leave sequence.exposures_us out")
    repeated = tuple(pattern for pattern in patterns for _ in exposures_us or (None,))
    frames = _frames(rig, patterns, exposures_us)
    return Stream(repeated, rig.projector.size, rig.camera.size, frames, {"devices": rig.identity})


def _frames(
    rig: Rig, patterns: tuple[Pattern, ...], exposures_us: tuple[float, ...]
) -> Iterator[tuple[Pattern, Frame]]:
    width, height = rig.camera.size
    for pattern, frame in _grabbed(rig, patterns, exposures_us):
        if frame.image.shape[:2] != (height, width):
            found = f"{frame.image.shape[1]} × {frame.image.shape[0]}"
            raise DeviceError(f"the camera says that its frames are {width} × {height}, but delivered one of {found}")
        yield pattern, frame


def _grabbed(
    rig: Rig, patterns: tuple[Pattern, ...], exposures_us: tuple[float, ...]
) -> Iterator[tuple[Pattern, Frame]]:
    for pattern in patterns:
        rig.projector.show(draw(pattern, rig.projector.size))
        for exposure_us in exposures_us:
            if isinstance(rig.camera, ExposureControl):
                rig.camera.expose_for(exposure_us)
            yield pattern, rig.camera.grab()
        if not exposures_us:
            yield pattern, rig.camera.grab()
