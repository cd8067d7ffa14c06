"""A capture folder from another program's frames, which are copied unchanged."""

from pathlib import Path

from scanner.capture import CAPTURE_FILE
from scanner.importing.layout import Size
from scanner.importing.recognition import Recognised
from scanner.io import MOST_IMAGE_FILE_BYTES, copy_given, flow_yaml
from scanner.patterns import FORMAT, frame_line, size_to_dict


def write_capture(folder: Path, found: Recognised, camera_size: Size) -> None:
    """`capture.yaml`, and `frames/` with the images under their own names, into an existing folder.

    Raises OSError, InputError.
    """
    frames = folder / "frames"
    frames.mkdir()
    header = {
        "format": FORMAT,
        "projector": size_to_dict(found.projector_size),
        "camera": size_to_dict(camera_size),
        "imported from": found.layout.title,
    }
    lines = [f"{flow_yaml(key)}: {flow_yaml(value)}\n" for key, value in header.items()] + ["frames:\n"]
    for path, pattern in zip(found.files, found.patterns, strict=True):
        copy_given(path, frames / path.name, MOST_IMAGE_FILE_BYTES)
        lines.append(frame_line(f"frames/{path.name}", pattern))
    (folder / CAPTURE_FILE).write_text("".join(lines), encoding="utf-8")
