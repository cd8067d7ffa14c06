"""Small images that would fill the memory, and damaged ones."""

import io
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from scanner.capture import open_capture
from scanner.decoding import require_decoding_memory
from scanner.errors import InputError
from scanner.io import read_image
from scanner.photos import read_photos
from tests.support.little_memory import little_memory
from tests.support.small_capture import read_listing


def chunk(name: bytes, content: bytes) -> bytes:
    """A part of a PNG."""
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))


def palette_png(width: int, height: int) -> bytes:
    """A PNG of one colour, tiny on disk."""
    compressor = zlib.compressobj(9)
    row = bytes(1 + (width + 7) // 8)
    pixels = b"".join(compressor.compress(row * 64) for _ in range(height // 64)) + compressor.flush()
    header = struct.pack(">IIBBBBB", width, height, 1, 3, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"PLTE", bytes(6)), (b"IDAT", pixels), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*each) for each in chunks)


def long_chunk() -> bytes:
    """A PNG with a chunk that claims 2 GB."""
    whole = palette_png(64, 64)
    at = whole.index(b"IDAT") - 4
    return whole[:at] + b"\x7f\xff\xff\xf0" + whole[at + 4 :]


def unmeasured_png() -> bytes:
    """A huge PNG with a broken comment: other readers report no size, and OpenCV reads the pixels."""
    whole = palette_png(32704, 32704)
    at = whole.index(b"PLTE") - 4
    return whole[:at] + chunk(b"pHYs", b"1") + whole[at:]


def tiff(size: int, strips: int, bits: int, compression: int, strip: bytes) -> bytes:
    """A grey TIFF whose strips are all at the same place."""
    after = 8 + len(strip)
    lists = after + 2 + 12 * 9 + 4
    tags = [(256, size), (257, size), (258, bits), (259, compression), (262, 1), (277, 1), (278, -(-size // strips))]
    entries = [struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags]
    for number, tag in enumerate((273, 279)):
        entries.insert(5 + 3 * number, struct.pack("<HHII", tag, 4, strips, lists + 4 * strips * number))
    places, lengths = struct.pack("<I", 8) * strips, struct.pack("<I", len(strip)) * strips
    directory = struct.pack("<H", len(entries)) + b"".join(entries) + bytes(4)
    return b"II*\0" + struct.pack("<I", after) + strip + directory + places + lengths


def resized(kind: str, marker: bytes, form: str, side: int = 14_999, **options: Any) -> bytes:
    """A small image whose header claims a huge size, at a marker."""
    stream = io.BytesIO()
    Image.new("RGB", (64, 64)).save(stream, kind, **options)
    data = stream.getvalue()
    at = data.index(marker) + len(marker)
    size = struct.pack(form, side, side)
    return data[:at] + size + data[at + len(size) :]


def many_scans() -> bytes:
    """A progressive JPEG whose last scan is repeated."""
    stream = io.BytesIO()
    Image.new("L", (64, 64)).save(stream, "JPEG", progressive=True)
    data = stream.getvalue()
    last = data.rindex(b"\xff\xda")
    return data[:last] + data[last:-2] * 20_000 + b"\xff\xd9"


IMAGES: dict[str, tuple[Callable[[], bytes], str]] = {
    "PNG that Pillow gives up": (unmeasured_png, "32704 × 32704 pixels, which would take 3,209 MB"),
    "TIFF of 32 bits": (lambda: tiff(14_999, 1, 32, 5, bytes(100)), "which would take 900 MB"),
    "TIFF, shared strips": (
        lambda: tiff(500, 500, 8, 8, zlib.compress(bytes(5_000_000))),
        "unpack to more than an image has",
    ),
    "JPEG 2000": (
        lambda: resized("JPEG2000", b"\xff\x4f\xff\x51\0\x2f\0\0", ">II", no_jp2=True),
        "which would take 3,375 MB",
    ),
    "progressive JPEG": (
        lambda: resized("JPEG", b"\xff\xc2\0\x11\x08", ">HH", progressive=True),
        "would take 1,350 MB",
    ),
    "JPEG written over": (many_scans, "its pixels are written 20,00. times over"),
    "GIF": (lambda: resized("GIF", b"GIF87a", "<HH"), "14999 × 14999 pixels, which would take"),
    "palette PNG": (lambda: palette_png(32704, 32704), "32704 × 32704 pixels, which would take 3,209 MB"),
    "PGM header": (lambda: b"P5\n52000 52000\n255\n" + bytes(1000), "52000 × 52000 pixels"),
    "16-bit PPM header": (lambda: b"P6\n14000 14000\n65535\n" + bytes(1000), "14000 × 14000 pixels"),
    "BMP": (
        lambda: b"BM" + struct.pack("<IIIIiiHHIIiiII", 70, 0, 54, 40, 30000, 30000, 1, 24, *[0] * 6),
        "30000 × 30000",
    ),
    "long chunk": (long_chunk, "truncated"),
}  # fmt: skip


@pytest.mark.parametrize("name", IMAGES)
def test_a_huge_image_is_refused_by_its_header(tmp_path: Path, name: str) -> None:
    content, words = IMAGES[name]
    path = tmp_path / "frame.png"
    path.write_bytes(content())
    with little_memory(), pytest.raises(InputError, match=words):
        read_image(path)


def test_a_frame_far_beyond_its_camera_is_refused_by_its_header(capture_folder: Path) -> None:
    frame = capture_folder / read_listing(capture_folder)["frames"][0]["file"]
    frame.write_bytes(palette_png(12800, 12800))
    with little_memory(), pytest.raises(InputError, match="would take 492 MB of memory; expected no more than 100 MB"):
        list(open_capture(capture_folder).stream().frames)


def test_a_photo_of_200_megapixels_is_accepted(tmp_path: Path) -> None:
    path = tmp_path / "photo.png"
    cv2.imwrite(str(path), np.zeros((12_240, 16_320), np.uint8), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    (photo,) = read_photos([path])
    assert (photo.size, photo.reduced) == ((8_160, 6_120), 2)


@pytest.mark.parametrize(("codes_alone", "told"), [(False, "70000.0 GB"), (True, "136000.0 GB")])
def test_frames_that_exceed_the_memory_are_refused_before_reading(codes_alone: bool, told: str) -> None:
    require_decoding_memory((2048, 2448), 50 * 2048 * 2448, codes_alone=codes_alone)
    if Path("/proc/meminfo").exists():
        with pytest.raises(InputError, match=f"take about {told} of memory"):
            require_decoding_memory((1_000_000, 1_000_000), 0, codes_alone=codes_alone)


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Sixteen bytes in the second half overwritten."""
    at = int(rng.integers(len(data) // 2, len(data) - 20))
    return data[:at] + rng.bytes(16) + data[at + 16 :]


def by_pillow(kind: str, **options: Any) -> bytes:
    rng = np.random.default_rng(0)
    pixels = cv2.GaussianBlur(rng.integers(0, 256, (150, 200, 3)).astype(np.uint8), (0, 0), 1)
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, kind, **options)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("data", "least"),
    [
        (by_pillow("PNG"), 1.0),
        (by_pillow("JPEG"), 0.4),  # where codes come back into step within a block, nobody can tell
        (by_pillow("JPEG", quality=95, subsampling=0, restart_marker_rows=1), 0.4),
        (by_pillow("TIFF", compression="tiff_lzw"), 0.9),
        (by_pillow("TIFF", compression="tiff_adobe_deflate"), 0.9),
    ],
    ids=["PNG", "JPEG", "JPEG with restarts", "TIFF LZW", "TIFF Deflate"],
)
def test_damaged_images_are_named(tmp_path: Path, data: bytes, least: float) -> None:
    path, rng, named = tmp_path / "frame", np.random.default_rng(1), 0
    path.write_bytes(data)
    whole = read_image(path)
    assert whole.shape == (150, 200, 3)
    for _ in range(40):
        path.write_bytes(damaged(data, rng))
        try:
            read_image(path)
        except InputError:
            named += 1
    assert named >= least * 40


@pytest.mark.parametrize("size", [(1, 1), (7, 9), (16, 17), (33, 150)])
@pytest.mark.parametrize("interval", [0, 1, 3])
def test_intact_jpegs_of_any_size_are_read(tmp_path: Path, size: tuple[int, int], interval: int) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (*size, 3)).astype(np.uint8)
    for channels in (pixels, pixels[..., 0]):
        data = cv2.imencode(".jpg", channels, [cv2.IMWRITE_JPEG_RST_INTERVAL, interval])[1].tobytes()
        (tmp_path / "a.jpg").write_bytes(data + b"and whatever a phone adds")
        assert read_image(tmp_path / "a.jpg").shape == channels.shape


@pytest.mark.parametrize("fill", [1, 2, 5])
def test_a_jpeg_may_have_fill_bytes_before_its_markers(tmp_path: Path, fill: int) -> None:
    """ITU-T T.81, B.1.1.2."""
    pixels = np.random.default_rng(0).integers(0, 256, (33, 150, 3)).astype(np.uint8)
    data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_RST_INTERVAL, 3])[1].tobytes()
    filled = re.sub(rb"\xff[\xd0-\xd7]", lambda marker: b"\xff" * fill + marker[0], data)
    assert len(filled) > len(data) + 3 * fill
    (tmp_path / "plain.jpg").write_bytes(data)
    (tmp_path / "filled.jpg").write_bytes(filled)
    np.testing.assert_array_equal(read_image(tmp_path / "filled.jpg"), read_image(tmp_path / "plain.jpg"))
