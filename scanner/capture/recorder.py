"""Writing a capture down, frame by frame, so that it can be replayed whenever the program, or the power, goes away."""

import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import replace
from datetime import UTC, datetime
from io import FileIO
from pathlib import Path

from hw.rig import Frame
from scanner.capture.stream import Stream
from scanner.io import flow_yaml, sync, sync_open, write_png
from scanner.patterns import FORMAT, Pattern, frame_line, pattern_to_dict, size_to_dict

CAPTURE_FILE, FRAMES_FOLDER = "capture.yaml", "frames"


def frame_file(index: int) -> str:
    """Return the path of a frame's image within a recording, relative to its folder."""
    return f"{FRAMES_FOLDER}/{index:03d}.png"


def record(stream: Stream, folder: Path) -> Stream:
    """The same stream; each frame is written, and listed in `capture.yaml`, before it is passed on.

    What was captured when a later frame fails is therefore a valid capture of fewer frames, and the listing says which
    patterns are missing. Frames are on the disk itself, whatever happens to the computer, before the next but one is
    asked for: a thread waits for the disk while the camera exposes.

    `folder` is made. Walking through the frames raises OSError if the disk does not take them.
    """
    return replace(stream, frames=_recorded(stream, folder))


def _recorded(stream: Stream, folder: Path) -> Iterator[tuple[Pattern, Frame]]:
    (folder / FRAMES_FOLDER).mkdir(parents=True)
    with (folder / CAPTURE_FILE).open("wb", buffering=0) as listing, _Syncing() as syncing:
        _append(listing, _keys(_header(stream)) + _sequence(stream.patterns) + "frames:\n")
        sync(folder)
        for index, (pattern, frame) in enumerate(stream.frames):
            file = frame_file(index)
            syncing.wait()
            _write_both(listing, frame_line(file, pattern, **_read_back(frame)), folder / file, frame)
            syncing.begin([folder / file, folder / FRAMES_FOLDER, folder / CAPTURE_FILE])
            yield pattern, frame
        _append(listing, _keys(stream.account()))
        syncing.wait()
        os.fsync(listing)


class _Syncing(AbstractContextManager["_Syncing"]):
    """Waits for the disk in a thread of its own, for what was written last."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="sync")
        self._pending: Future[None] | None = None

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown()

    def begin(self, paths: Sequence[Path]) -> None:
        """Of files and folders, which may be moved meanwhile. Raises OSError."""
        self._pending = self._pool.submit(_sync_all, [os.open(path, os.O_RDONLY) for path in paths])

    def wait(self) -> None:
        """Until that is done. Raises OSError if the disk has failed."""
        if self._pending is not None:
            self._pending.result()
            self._pending = None


def _sync_all(descriptors: Sequence[int]) -> None:
    try:
        for descriptor in descriptors:
            sync_open(descriptor)
    finally:
        for descriptor in descriptors:
            os.close(descriptor)


def _write_whole(path: Path, frame: Frame) -> None:
    """An image has its name only when it is whole: none that a kill has torn looks like a frame."""
    hidden = path.with_name(f".{path.name}")
    try:
        write_png(hidden, frame.image)
        hidden.rename(path)
    except BaseException:
        hidden.unlink(missing_ok=True)
        raise


def _write_both(listing: FileIO, line: str, image: Path, frame: Frame) -> None:
    """An image and its line in the listing, or neither, also when Ctrl-C or a full disk comes between them."""
    end = listing.tell()
    try:
        _write_whole(image, frame)
        _append(listing, line)
    except BaseException:
        if listing.tell() < end + len(
            line.encode()
        ):  # a frame that is listed is safe: what comes later does not take it back
            listing.truncate(end)
            image.unlink(missing_ok=True)
        raise


def _append(listing: FileIO, text: str) -> None:
    data = text.encode()
    while data:  # what is left of a disk may take a part of it; the rest tells why
        data = data[listing.write(data) :]


def _keys(values: Mapping[str, object]) -> str:
    return "".join(f"{key}: {flow_yaml(value)}\n" for key, value in values.items())


def _sequence(patterns: Sequence[Pattern]) -> str:
    """Return the complete planned sequence, so that a capture that stops early states what is missing."""
    return "sequence:\n" + "".join(f"  - {flow_yaml(pattern_to_dict(pattern))}\n" for pattern in patterns)


def _header(stream: Stream) -> dict[str, object]:
    return {
        "format": FORMAT,
        "projector": size_to_dict(stream.projector_size),
        "camera": size_to_dict(stream.camera_size),
        "captured": datetime.now(UTC).isoformat(timespec="seconds"),
        **stream.metadata,
    }


def _read_back(frame: Frame) -> dict[str, float | int]:
    values = {"exposure_us": frame.exposure_us, "timestamp_ns": frame.timestamp_ns}
    return {key: value for key, value in values.items() if value is not None}
