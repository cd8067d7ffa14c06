"""Inputs that no command writes, made once of the first checkout's results, and given to both."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from filming import Camera, Clip, film, play
from numpy.typing import NDArray

from calib.numerics import Image

_CAPTURE = "out/capture"
# The smallest projector that is sold, so that the import recognises its size.
_PROJECTOR = {"x": 640, "y": 360}


@dataclass(frozen=True)
class Input:
    """`make(folder, *results)` fills a folder from the folders of the results of `cases`."""

    make: Callable[..., None]
    cases: tuple[str, ...]


def _read_grey(path: Path) -> NDArray[np.uint8]:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise FileNotFoundError(path)
    return np.asarray(image, np.uint8)


def _frames(capture: Path) -> list[Path]:
    return sorted((capture / "frames").iterdir())


def _copy_capture(scan: Path, folder: Path) -> list[Path]:
    shutil.copytree(scan / _CAPTURE, folder, dirs_exist_ok=True)
    return _frames(folder)


def _make_swapped(folder: Path, scan: Path) -> None:
    """Two frames of a capture have changed places."""
    frames = _copy_capture(scan, folder)
    first, second = (frames[number].read_bytes() for number in (6, 7))
    frames[6].write_bytes(second)
    frames[7].write_bytes(first)


def _make_stopped(folder: Path, scan: Path) -> None:
    """The projector stopped: the last frames of a capture show one picture."""
    frames = _copy_capture(scan, folder)
    for frame in frames[14:]:
        shutil.copyfile(frames[13], frame)


def _make_damaged(folder: Path, scan: Path) -> None:
    """A frame of a capture ends early."""
    frame = _copy_capture(scan, folder)[5]
    frame.write_bytes(frame.read_bytes()[:1000])


def _make_one_axis(folder: Path, scan: Path) -> None:
    """A capture without the patterns along y."""
    _copy_capture(scan, folder)
    listing = yaml.safe_load((folder / "capture.yaml").read_text(encoding="utf-8"))
    for entry in [entry for entry in listing["frames"] if entry["pattern"].get("axis") == "y"]:
        (folder / entry["file"]).unlink()
        listing["frames"].remove(entry)
    sizes = {key: listing[key] for key in ("format", "projector", "camera", "frames")}
    (folder / "capture.yaml").write_text(yaml.safe_dump(sizes), encoding="utf-8")


def _make_captures(folder: Path, scan: Path, refused: Path) -> None:
    """A good capture, a damaged one, and one that is refused, for a batch."""
    _copy_capture(scan, folder / "good")
    _make_damaged(folder / "damaged", scan)
    _copy_capture(refused, folder / "refused")


def _make_masks(folder: Path, scan: Path) -> None:
    """The faces of a corner, as they are drawn by hand."""
    with np.load(scan / "out" / "matches.npz") as matches:
        camera_px, face = matches["camera_px"], matches["face"]
    shape = _read_grey(_frames(scan / _CAPTURE)[0]).shape
    taken = np.zeros(shape, bool)
    for label in range(3):
        hull = cv2.convexHull(np.rint(camera_px[face == label]).astype(np.int32))
        inside = (cv2.fillConvexPoly(np.zeros(shape, np.uint8), hull, 255.0) > 0) & ~taken
        taken |= inside
        cv2.imwrite(str(folder / f"{label}.png"), np.where(inside, 255, 0).astype(np.uint8))


def _make_unturned(folder: Path, thing: Path) -> None:
    """One station of a thing, twice."""
    for name in ("1", "2"):
        shutil.copytree(thing / "out" / "captures" / "1", folder / name)


def _make_photos(folder: Path, room: Path) -> None:
    """What the camera saw while the projector was dark; and the first photo again."""
    for number, capture in enumerate((*(room / f"out/captures/{n}/capture" for n in (1, 2)), room / _CAPTURE)):
        shutil.copyfile(_frames(capture)[1], folder / f"{number}.png")
    shutil.copyfile(folder / "0.png", folder / "0-again.png")


def _gray_code(axis: str) -> list[tuple[str, int, bool]]:
    bits = (_PROJECTOR[axis] - 1).bit_length()
    return [(axis, bit, inverted) for bit in reversed(range(bits)) for inverted in (False, True)]


def _make_foreign(folder: Path, scan: Path) -> None:
    """What OpenCV's GrayCodePattern would have made of a scan: each bit and its inverse, then white and black."""
    with np.load(scan / "out" / "matches.npz") as matches:
        column, row = np.rint(matches["camera_px"]).astype(int).T
        projector_px = matches["projector_px"]
    white, black = (_read_grey(frame).astype(np.float64) for frame in _frames(scan / _CAPTURE)[:2])
    listing = yaml.safe_load((scan / _CAPTURE / "capture.yaml").read_text(encoding="utf-8"))
    size = [listing["projector"][side] for side in ("width", "height")]
    coordinate = (projector_px + 0.5) / size * list(_PROJECTOR.values())
    rng = np.random.default_rng(0)
    patterns: list[tuple[str, int, bool] | bool] = [*_gray_code("x"), *_gray_code("y"), True, False]
    for number, pattern in enumerate(patterns):
        light = np.full(white.shape, 0.3)
        light[row, column] = _is_bright(pattern, coordinate)
        image = black + (white - black) * light + rng.standard_normal(white.shape)
        cv2.imwrite(str(folder / f"graycode_{number:02d}.png"), np.clip(np.rint(image), 0, 255).astype(np.uint8))


def _is_bright(pattern: tuple[str, int, bool] | bool, coordinate: NDArray[np.float64]) -> Any:
    if isinstance(pattern, bool):
        return pattern
    axis, bit, inverted = pattern
    cell = np.floor(coordinate[:, "xy".index(axis)]).astype(np.int64)
    return ((cell ^ cell >> 1) >> bit & 1) != inverted


def _make_foreign_short(folder: Path, scan: Path) -> None:
    """The same, of which some frames were not taken."""
    _make_foreign(folder, scan)
    for number in (9, 10, 25):
        (folder / f"graycode_{number:02d}.png").unlink()


def _make_film(folder: Path, video: Path, room: Path) -> None:
    """A film of a video, shown in a room of which there is a scan with the same patterns; and half of that file."""
    shown = [_read_grey(path).astype(np.float32) for path in sorted((video / "out" / "patterns").iterdir())]
    seen = [np.asarray(_read_grey(path) / 255.0, np.float32) for path in _frames(room / _CAPTURE)]

    def light_of(picture: Image) -> NDArray[np.float32]:
        return seen[int(np.argmin([np.mean(np.abs(picture - pattern)) for pattern in shown]))]

    played = play(video / "out" / "sequence.mp4")
    film(folder / "film.mp4", played, light_of, Camera(bit_rate=1.5e6), Clip(0.7, played.length_s - 0.7))
    whole = (folder / "film.mp4").read_bytes()
    (folder / "cut.mp4").write_bytes(whole[: len(whole) // 2])


INPUTS = {
    "swapped": Input(_make_swapped, ("scan-standard",)),
    "stopped": Input(_make_stopped, ("scan-square",)),
    "damaged": Input(_make_damaged, ("scan-square",)),
    "one-axis": Input(_make_one_axis, ("scan-square",)),
    "captures": Input(_make_captures, ("scan-square", "scan-refused")),
    "masks": Input(_make_masks, ("scan-square",)),
    "unturned": Input(_make_unturned, ("object",)),
    "photos": Input(_make_photos, ("photographed-room",)),
    "foreign": Input(_make_foreign, ("scan-square",)),
    "foreign-short": Input(_make_foreign_short, ("scan-square",)),
    "film": Input(_make_film, ("video", "filmed-room")),
}
