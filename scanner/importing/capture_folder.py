"""A capture folder from another program's frames, which are copied unchanged or mirrored back."""

from pathlib import Path

from calib.geometry import SQUARE_PIXELS, PixelGrid
from scanner.capture import CAPTURE_FILE
from scanner.importing.frame_files import read_frame
from scanner.importing.layout import Size
from scanner.importing.recognition import Recognised
from scanner.io import MOST_IMAGE_FILE_BYTES, copy_given, flow_yaml, write_png
from scanner.patterns import FORMAT, Axis, aspect_to_dict, frame_line, size_to_dict


def write_capture(
    folder: Path,
    recognised: Recognised,
    camera_size: Size,
    flip: Axis | None = None,
    grid: PixelGrid = SQUARE_PIXELS,
) -> None:
    """`capture.yaml`, and `frames/` with the images under their own names, into an existing folder.

    Images that are to be mirrored back along an axis are written as PNG. `grid`: the pixels of the projector, of which
    patterns and size are told in square ones.

    Raises OSError, InputError.
    """
    frames = folder / "frames"
    frames.mkdir()
    header = {
        "format": FORMAT,
        "projector": size_to_dict(recognised.projector_size),
        **aspect_to_dict(grid),
        "camera": size_to_dict(camera_size),
        "imported from": recognised.layout.title,
    }
    lines = [f"{flow_yaml(key)}: {flow_yaml(value)}\n" for key, value in header.items()] + ["frames:\n"]
    for path, pattern in zip(recognised.files, recognised.patterns, strict=True):
        name = path.name if flip is None else f"{path.stem}.png"
        if flip is None:
            copy_given(path, frames / name, MOST_IMAGE_FILE_BYTES)
        else:
            write_png(frames / name, read_frame(path, flip))
        lines.append(frame_line(f"frames/{name}", pattern))
    (folder / CAPTURE_FILE).write_text("".join(lines), encoding="utf-8")
