"""Rig and patterns → the stream that everything else consumes."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby, tee
from operator import itemgetter

from calib.geometry import Size
from calib.numerics import Image
from hw.errors import DeviceError
from hw.rig import Camera, Frame, Frames, Redundancy, Rig, exposure_control
from scanner.patterns import Pattern, ProjectorResponse, draw, level_groups, unpaired_bits


@dataclass(frozen=True)
class Stream:
    """Patterns and the frames that show them, one after the other; live, simulated or recorded looks the same."""

    patterns: tuple[Pattern, ...]
    projector_size: Size
    camera_size: Size
    frames: Iterator[tuple[Pattern, Frame]]
    """Can be walked through once."""
    metadata: Mapping[str, object] = field(default_factory=dict)
    """Further keys for the recording."""
    account: Callable[[], Mapping[str, object]] = dict
    """Those keys that are known only when the frames have been walked through."""

    def shown_as(self, patterns: Sequence[Pattern | None]) -> "Stream":
        """The same frames with other names for what they show, without those that have None."""
        kept = tuple(pattern for pattern in patterns if pattern is not None)
        renamed = zip(patterns, self.frames, strict=True)
        return replace(self, patterns=kept, frames=((p, frame) for p, (_, frame) in renamed if p is not None))


def capture(
    rig: Rig,
    patterns: tuple[Pattern, ...],
    exposures_us: tuple[float, ...] = (),
    response: ProjectorResponse | None = None,
) -> Stream:
    """Project each pattern and grab a frame of it, or one at each of `exposures_us`, when the frame is asked for, with
    the rig's first camera.

    With a known `response` the projector is sent what makes its light proportional to the pattern. That is what the
    recording's patterns describe: it does not matter to who reads it how the light came about.

    Raises DeviceError if the camera cannot expose for what is wanted, or makes the same of two exposures. Walking
    through `frames` raises DeviceError if a device fails or the camera delivers frames of another size.
    """
    return capture_together(rig, patterns, exposures_us, response)[0]


def capture_together(
    rig: Rig,
    patterns: tuple[Pattern, ...],
    exposures_us: tuple[float, ...] = (),
    response: ProjectorResponse | None = None,
) -> tuple[Stream, ...]:
    """As `capture`: a stream for each of the rig's cameras, which all see each pattern when it is projected.

    The streams are to be walked through side by side: frames that only one of them has passed on are kept in memory.
    """
    for camera_rig in rig.all if exposures_us else ():
        _try_exposures(camera_rig.camera, exposures_us)
    repeated = tuple(pattern for pattern in patterns for _ in exposures_us or (None,))
    undone = {} if response is None else {"response": f"gamma {response.gamma:.2f}, undone"}
    taken = tee(_taken(rig, repeated, exposures_us, response), len(rig.all))
    return tuple(
        Stream(
            repeated,
            Size(*rig.projector.size),
            Size(*camera_rig.camera.size),
            _frames(camera_rig.camera, repeated, map(itemgetter(number), frames)),
            {"devices": camera_rig.identity | undone},
            rig.account,
        )
        for number, (camera_rig, frames) in enumerate(zip(rig.all, taken, strict=True))
    )


def _taken(
    rig: Rig, patterns: tuple[Pattern, ...], exposures_us: tuple[float, ...], response: ProjectorResponse | None
) -> Iterator[Frames]:
    """Nothing is shown before the first frame is asked for."""
    pictures = _pictures(patterns, rig.projector.size, response)
    redundancy = Redundancy(level_groups(patterns), unpaired_bits(patterns))
    yield from rig.photograph_together(pictures, exposures_us, redundancy)


def _frames(camera: Camera, patterns: tuple[Pattern, ...], frames: Iterator[Frame]) -> Iterator[tuple[Pattern, Frame]]:
    for pattern, frame in zip(patterns, frames, strict=True):
        refuse_another_size(frame, camera.size)
        yield pattern, frame


def refuse_another_size(frame: Frame, size: tuple[int, int]) -> None:
    """Raise DeviceError if a frame is not of the camera's size, (width, height)."""
    height, width = frame.image.shape[:2]
    if (width, height) != size:
        raise DeviceError(
            f"the camera says that its frames are {size[0]} × {size[1]}, but delivered one of {width} × {height}"
        )


def _pictures(
    patterns: Iterable[Pattern], size: tuple[int, int], response: ProjectorResponse | None
) -> Iterator[Image]:
    """The picture of each pattern; the same one where a pattern follows itself."""
    for pattern, repeated in groupby(patterns):
        picture = draw(pattern, size) if response is None else response.compensation[draw(pattern, size)]
        yield from (picture for _ in repeated)


def _try_exposures(camera: Camera, exposures_us: tuple[float, ...]) -> None:
    """Check that the camera can set the exposures, before the first frame. Raises DeviceError."""
    control = exposure_control(camera)
    became = [control.expose_for(exposure_us) for exposure_us in exposures_us]
    for number, (wanted, actual) in enumerate(zip(exposures_us, became, strict=True)):
        if actual in became[:number]:
            earlier_us = exposures_us[became.index(actual)]
            raise DeviceError(
                f"the camera sets {earlier_us:g} and {wanted:g} µs in exposures_us both to {actual:.0f} µs: "
                "exposures are whole numbers of the projector's refresh periods; choose some that are further apart"
            )
