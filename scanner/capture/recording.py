"""Reading a capture folder: `capture.yaml` and a frame for each pattern, checked before use."""

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, field_validator, model_validator

from calib.finding import Finding
from calib.geometry import PixelGrid, Size
from calib.numerics import Image, processors
from hw.ahead import prefetched
from hw.rig import Frame
from scanner.capture.damaged_listing import (
    damaged_image,
    left_out,
    missing_files,
    planned_patterns,
    read_listing,
    unlisted,
)
from scanner.capture.recorder import CAPTURE_FILE, FRAMES_FOLDER
from scanner.capture.stream import Stream
from scanner.errors import InputError
from scanner.io import (
    LONGEST_SIDE_PX,
    MOST_IMAGE_FILE_BYTES,
    SUFFIXES,
    Entry,
    Whole,
    copy_given,
    read_image,
    refuse_more_pixels,
    require_space,
    validate,
)
from scanner.patterns import (
    FORMAT,
    PIXEL_ASPECT_KEY,
    SEQUENCE_FILE,
    Pattern,
    PatternEntry,
    White,
    in_square_pixels,
    level_groups,
)
from scanner.shown_text import shown

_SHORTEST_EXPOSURE_US, _LONGEST_EXPOSURE_US = 1e-3, 1e9


class _SizeEntry(Entry):
    width: Whole = Field(ge=1, le=LONGEST_SIDE_PX)
    height: Whole = Field(ge=1, le=LONGEST_SIDE_PX)

    @model_validator(mode="after")
    def _is_read(self) -> "_SizeEntry":
        refuse_more_pixels(self.width, self.height)
        return self


class _FrameEntry(Entry):
    file: str = Field(min_length=1)
    pattern: PatternEntry
    exposure_us: object = None
    timestamp_ns: object = None

    @property
    def read_back(self) -> tuple[float | None, int | None]:
        """Read exposure and time stamp. Other programs may use these keys otherwise, which is no error."""
        exposures, shortest, longest = self.exposure_us, _SHORTEST_EXPOSURE_US, _LONGEST_EXPOSURE_US
        exposure_us = exposures if isinstance(exposures, float | int) and shortest <= exposures <= longest else None
        return exposure_us, self.timestamp_ns if isinstance(self.timestamp_ns, int) else None


class _CaptureEntry(Entry):
    format: Whole
    projector: _SizeEntry
    camera: _SizeEntry
    frames: list[_FrameEntry] = Field(min_length=1)

    @field_validator("format")
    @classmethod
    def _known_format(cls, number: int) -> int:
        if number != FORMAT:
            raise ValueError(f"this version reads format {FORMAT}, found {number}")
        return number


@dataclass(frozen=True)
class Recording:
    """A capture on disk whose listing was checked; its images are read, and checked, one at a time."""

    folder: Path
    files: tuple[str, ...]
    """Paths of the frames relative to `folder`, one for each of `patterns`."""
    patterns: tuple[Pattern, ...]
    projector_size: Size
    camera_size: Size
    metadata: Mapping[str, Any]
    """All of `capture.yaml`."""
    read_back: tuple[tuple[float | None, int | None], ...]
    """Exposures (µs) and time stamps (ns) of the frames where known."""
    planned: tuple[Pattern, ...] = ()
    """The patterns that were to be shown, as far as the recording says so, the frames' own first; empty if it does
    not.
    """
    findings: tuple[Finding, ...] = ()
    """What is left out of it."""

    def stream(self) -> Stream:
        """The capture as it once arrived. Walking through the frames raises InputError at the first bad image."""
        return Stream(self.patterns, self.projector_size, self.camera_size, self._frames(), self.metadata)

    def white(self) -> Image | None:
        """The frame of the scene fully lit or, without one, the mean of the first frames that light every place alike;
        None if there are none of either. Raises InputError if they cannot be read.
        """
        listed = zip(self.patterns, self.files, strict=True)
        file = next((file for pattern, file in listed if isinstance(pattern, White)), None)
        if file is not None:
            return read_image(self.folder / file)
        group = next(iter(level_groups(self.patterns)), ())
        images = [read_image(self.folder / self.files[number], self.camera_size) for number in group]
        return np.rint(np.mean(images, axis=0)).astype(images[0].dtype) if images else None

    def in_square_pixels(self, grid: PixelGrid) -> "Recording":
        """The capture with size and patterns told in square pixels, if they are in those of a grid.

        Raises InputError if the capture says that they were in those of another.
        """
        known = self.metadata.get(PIXEL_ASPECT_KEY, None if grid.aspect != 1 else 1.0)
        if known is None:
            patterns, size = in_square_pixels(self.patterns, self.projector_size, grid)
            planned, _ = in_square_pixels(self.planned, self.projector_size, grid)
            return replace(self, patterns=patterns, planned=planned, projector_size=size)
        if known != grid.aspect and grid.aspect != 1:
            raise InputError(
                f"{self.folder}: its projector's pixels have a {PIXEL_ASPECT_KEY} of {shown(known)}, but "
                f"projector.pixel_aspect is {grid.aspect:g}: set it to that, or leave it out"
            )
        return self

    def _frames(self) -> Iterator[tuple[Pattern, Frame]]:
        first: Image | None = None
        images = prefetched(self._image, self.files, processors())
        for pattern, file, read_back, image in zip(self.patterns, self.files, self.read_back, images, strict=True):
            first = image if first is None else first
            if (image.dtype, image.shape) != (first.dtype, first.shape):
                raise InputError(
                    f"{self.folder / file}: expected {_kind(first)} like {self.files[0]}, found {_kind(image)}"
                )
            yield pattern, Frame(image, *read_back)

    def _image(self, file: str) -> Image:
        image = read_image(self.folder / file, self.camera_size)
        actual = Size.of(image)
        if actual != self.camera_size:
            swapped = "; are width and height swapped?" if actual[::-1] == self.camera_size else ""
            raise InputError(
                f"{self.folder / file}: expected {self.camera_size} pixels, the size of the camera in "
                f"{CAPTURE_FILE}, found {actual}{swapped}"
            )
        return image

    def copy_to(self, folder: Path) -> None:
        """Copy the listing and the frames it lists into a new folder. Raises OSError, StorageError, InputError."""
        total_bytes = sum((self.folder / file).stat().st_size for file in self.files)
        require_space(folder, len(self.files), total_bytes, "a copy of the capture")
        for file in (CAPTURE_FILE, *self.files):
            target = folder / file
            target.parent.mkdir(parents=True, exist_ok=True)
            copy_given(self.folder / file, target, MOST_IMAGE_FILE_BYTES)


def _kind(image: Image) -> str:
    return f"{image.dtype.itemsize * 8}-bit {'grey' if image.ndim == 2 else 'colour'} images"


def open_capture(path: Path) -> Recording:
    """Read and check the listing of a capture folder (or the path of its `capture.yaml`).

    What was being written when a recording was broken off is left out: a torn last line, a last frame that is missing
    or damaged, the image that was to be listed next. So are listed files that are missing, unless all are. `path` may
    also be the folder of the frames.

    Raises InputError for a missing or malformed listing, an unknown pattern, a file listed twice, a file outside the
    folder, and an image beside the frames that is not listed.
    """
    folder = path.parent if path.name == CAPTURE_FILE else capture_above(path) or path
    listing = _listing_in(folder)
    data, findings = read_listing(listing)
    entry = validate(_CaptureEntry, data, str(listing))
    frames, unread = entry.frames, set[Path]()
    if len(frames) > 1 and (torn := damaged_image(folder, frames[-1].file)):
        unread.add((folder / frames[-1].file).resolve())
        frames, findings = frames[:-1], (*findings, torn)
    by_file = [(frame, _frame_path(listing, frame.file)) for frame in frames]
    missing = [frame.file for frame, path in by_file if not path.exists()]
    if len(missing) == len(by_file):
        raise InputError(f"{listing}: frame {shown(missing[0])} is missing, as are all others")
    if missing:
        by_file = [(frame, path) for frame, path in by_file if path.exists()]
        frames, findings = [frame for frame, _ in by_file], (*findings, missing_files(missing))
    files, paths = tuple(frame.file for frame in frames), tuple(path for _, path in by_file)
    patterns = tuple(frame.pattern.pattern() for frame in frames)
    _refuse_repeats(listing, paths, "shows the file", files)
    planned = planned_patterns(data, patterns)
    if len(planned) > len(patterns) and (extra := unlisted(folder, len(entry.frames))):
        unread.add(extra.resolve())
        findings = (*findings, left_out(f"The image {extra.name} is left out: it was not listed any more."))
    _refuse_extra_images(folder, {*paths, *unread})
    return Recording(
        folder,
        files,
        patterns,
        Size(entry.projector.width, entry.projector.height),
        Size(entry.camera.width, entry.camera.height),
        data,
        tuple(frame.read_back for frame in frames),
        planned,
        findings,
    )


def capture_above(frames: Path) -> Path | None:
    """The capture of which a folder holds the frames; None if it is none, or a capture itself."""
    folder = frames.absolute().parent
    if (frames / CAPTURE_FILE).exists() or frames.name != FRAMES_FOLDER or not (folder / CAPTURE_FILE).is_file():
        return None
    return folder if frames.is_absolute() or len(frames.parts) < 2 else frames.parent


def _listing_in(folder: Path) -> Path:
    listing = folder / CAPTURE_FILE
    if listing.is_file():
        # Or what anyone keeps in a file beside would be copied into results, and quoted in messages.
        if not listing.resolve().is_relative_to(folder.resolve()):
            raise InputError(f"{listing}: is a link that leads out of the capture folder")
        return listing
    if not folder.exists():
        raise InputError(f"{folder}: no such capture folder")
    if folder.name == SEQUENCE_FILE or (folder / SEQUENCE_FILE).is_file():
        raise InputError(
            f"{folder}: expected a capture, found a sequence of patterns to project: project its images, "
            f"photograph each, and list the photographs with their patterns and the camera's size in a {CAPTURE_FILE}"
        )
    if (folder / "capture" / CAPTURE_FILE).is_file():
        raise InputError(f"{folder}: expected a capture, found a result; its recording is {folder / 'capture'}")
    raise InputError(f"{folder}: expected a capture folder, found no {CAPTURE_FILE} in it")


def _frame_path(listing: Path, file: str) -> Path:
    """The real path of a listed frame, which is inside the capture folder after links are resolved, and is a file if it
    exists.
    """
    if Path(file).is_absolute() or ".." in Path(file).parts or "\0" in file:
        raise InputError(f"{listing}: frame {shown(file)} must be a path inside the capture folder")
    root = listing.parent.resolve()
    try:
        path = (root / file).resolve()
        is_something_else = path.exists() and not path.is_file()
    except (OSError, RuntimeError) as error:  # a name that is too long, links in a circle
        raise InputError(f"{listing}: frame {shown(file)} cannot be found: {error}") from error
    if not path.is_relative_to(root):
        raise InputError(f"{listing}: frame {shown(file)} is a link that leads out of the capture folder")
    if is_something_else:
        raise InputError(f"{listing}: frame {shown(file)} is no file")
    return path


def _refuse_repeats(listing: Path, values: Sequence[Hashable], what: str, names: Sequence[str]) -> None:
    first_with: dict[Hashable, int] = {}
    for index, value in enumerate(values):
        if value in first_with:
            raise InputError(
                f"{listing}: frame {index} {what} of frame {first_with[value]} again: {shown(names[index])}"
            )
        first_with[value] = index


def _refuse_extra_images(folder: Path, listed: set[Path]) -> None:
    """An unlisted image among the frames means that listing and frames do not belong together.

    Images beside `capture.yaml` itself are nobody's business.
    """
    root = folder.resolve()
    for place in sorted({path.parent for path in listed} - {root}):
        for path in sorted(place.iterdir()):
            if path.suffix.lower() in SUFFIXES and not path.name.startswith(".") and path.resolve() not in listed:
                raise InputError(
                    f"{folder / CAPTURE_FILE}: the image {path.relative_to(root)} is not listed: list it with its "
                    "pattern, or take it out of the frames' folder"
                )
