"""Taking up a capture that was broken off: the same rig before the same scene shows what is missing."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain

from hw.rig import Frame, Rig
from scanner.capture.recording import Recording
from scanner.capture.same_scene import refuse_another_scene, scale_of
from scanner.capture.stream import Stream, capture
from scanner.errors import InputError
from scanner.io import read_image
from scanner.patterns import Gray, Pattern, Phase, ProjectorResponse, White, Xor

# What differs from start to start of one and the same rig.
_MEASURED = {"light after a flip"}


def take_up(
    begun: Recording,
    rig: Rig,
    patterns: Sequence[Pattern],
    exposures_us: tuple[float, ...] = (),
    response: ProjectorResponse | None = None,
) -> Stream:
    """A capture whose first frames are those that were recorded, and whose others are taken now: what the recording
    says that was to come, or else the rest of `patterns`.

    In between some patterns are shown again. That they look as they did is checked here; they stay in the stream as
    witnesses of smaller motions. Raises InputError if rig or scene are not as they were, or nothing is missing;
    DeviceError.
    """
    repeats = max(1, len(exposures_us))
    planned = begun.planned or tuple(pattern for pattern in patterns for _ in range(repeats))
    _require_first(begun, planned, repeats)
    once, taken = planned[::repeats], len(begun.patterns) // repeats
    again = capture(rig, _witnesses(once[:taken]), exposures_us, response)
    _refuse_other_devices(begun, again.metadata)
    witnesses = [*again.frames]
    _compare(begun, witnesses, repeats)
    rest = capture(rig, once[taken:], exposures_us, response)
    return replace(
        rest,
        patterns=(*begun.patterns[: taken * repeats], *again.patterns, *rest.patterns),
        frames=chain(_recorded(begun, taken * repeats), witnesses, rest.frames),
        metadata={
            **rest.metadata,
            "resumed": {"after_frames": taken * repeats, "begun": begun.metadata.get("captured")},
        },
    )


def _require_first(begun: Recording, planned: Sequence[Pattern], repeats: int) -> None:
    once = [pattern for pattern in planned[::repeats] for _ in range(repeats)]
    if begun.patterns != tuple(planned[: len(begun.patterns)]) or once != list(planned):
        raise InputError(
            f"{begun.folder}: its patterns are not the first of the configured sequence: use the configuration that it "
            "was begun with"
        )
    if len(begun.patterns) == len(planned):
        raise InputError(f"{begun.folder}: nothing is missing; scan replay {begun.folder} makes a result of it")


def _witnesses(taken: Sequence[Pattern]) -> tuple[Pattern, ...]:
    """Return white and, along each axis, the finest stripes of the code and of the fringes, where there are any."""
    chosen: list[Pattern] = []
    chosen += [pattern for pattern in taken if isinstance(pattern, White)][:1]
    for axis in ("x", "y"):
        for kind in (Gray | Xor, Phase):
            chosen += [pattern for pattern in taken if isinstance(pattern, kind) and pattern.axis == axis][-1:]
    return tuple(chosen)


def _refuse_other_devices(begun: Recording, now: Mapping[str, object]) -> None:
    before, devices = begun.metadata.get("devices"), now.get("devices")
    if not isinstance(before, Mapping) or not isinstance(devices, Mapping):
        return
    differing = [
        f"{name}: {before.get(name, 'nothing')} then, {devices.get(name, 'nothing')} now"
        for name in dict.fromkeys([*before, *devices])
        if name not in _MEASURED and str(before.get(name)) != str(devices.get(name))
    ]
    if differing:
        raise InputError(f"{begun.folder}: was begun with another rig, or with other settings: {'; '.join(differing)}")


def _compare(begun: Recording, witnesses: Sequence[tuple[Pattern, Frame]], repeats: int) -> None:
    scale = 0.0  # by the first, which is white if that was shown
    for number, (pattern, frame) in enumerate(witnesses):
        index = begun.patterns.index(pattern) + number % repeats
        before = read_image(begun.folder / begun.files[index])
        scale = scale or scale_of(before, begun.projector_size)
        refuse_another_scene(f"frame {index} ({begun.files[index]})", before, frame.image, scale)


def _recorded(begun: Recording, count: int) -> Iterator[tuple[Pattern, Frame]]:
    for _, frame in zip(range(count), begun.stream().frames, strict=False):
        yield frame
