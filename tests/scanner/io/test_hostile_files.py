"""Files that are small, and were made to hang the program, to fill its memory, or to be obeyed by a terminal."""

import io
import os
import resource
import socket
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from scanner.capture import identity, open_capture
from scanner.commands.main import main
from scanner.decoding.memory import refuse_more_than_there_is
from scanner.errors import InputError
from scanner.io import flow_yaml, parse_yaml, read_calibration, read_cloud, read_image, read_matches, read_yaml
from scanner.photos.photo import read_photos
from tests.support.small_capture import read_listing

_ROOM_BYTES = 200_000_000


@contextmanager
def little_memory() -> Iterator[None]:
    """No more address space than there is in use, and a little."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + _ROOM_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def aliases(levels: int = 9, width: int = 9) -> str:
    """Ten lines that stand for billions of values."""
    names = "abcdefghij"[:levels]
    lines = [f"{names[0]}: &{names[0]} [{', '.join('x' * width)}]"]
    lines += [f"{b}: &{b} [{', '.join([f'*{a}'] * width)}]" for a, b in pairwise(names)]
    return "\n".join(lines)


YAML: dict[str, tuple[str, str]] = {
    "aliases": (aliases(), "more than 30,000 values"),
    "merged aliases": (
        "b0: &b0 {k: 1}\n" + "\n".join(f"b{i}: &b{i} {{<<: [{', '.join([f'*b{i - 1}'] * 9)}]}}" for i in range(1, 9)),
        "more than 30,000 values",
    ),
    "a long text, often": (f"a: &a {'x' * 20_000}\nb: [{', '.join(['*a'] * 2000)}]", "more than 30,000 values"),
    "a value in itself": ("a: &a [*a]", "contains itself"),
    "brackets": ("[" * 100_000, "nested too deeply"),
    "many keys": ("\n".join(f"k{i}: 1" for i in range(40_000)), "more than 30,000 values"),
    "a type that is none": ("a: !!bool perhaps", "not of the type that its tag says"),
    "no number": ("a: !!int ''", "a number is expected"),
    "base sixty": ("a: !!int " + "1:" * 50_000 + "1", "a number is expected"),
    "a date that is none": ("a: 2024-13-45", "month must be in"),
    "a tag to be obeyed": ("!<%1b[31m> x", "could not determine a constructor"),
}  # fmt: skip


@pytest.mark.parametrize("name", YAML)
def test_hostile_yaml_is_refused(name: str) -> None:
    text, words = YAML[name]
    with little_memory(), pytest.raises(InputError, match=words) as caught:
        parse_yaml(text, "room.yaml")
    assert "\x1b" not in str(caught.value)
    assert len(str(caught.value)) < 400


def test_numbers_are_those_of_yaml_1_2_and_of_64_bits() -> None:
    found = parse_yaml(f"[1:30, 1e3, 1_000, 0x1F, {'9' * 5000}, 0x{'f' * 5000}, {'1:' * 5000}1]", "")
    assert found == ["1:30", 1000.0, 1000, 31, "9" * 5000, f"0x{'f' * 5000}", f"{'1:' * 5000}1"]


def test_a_few_aliases_are_no_bomb() -> None:
    assert parse_yaml("a: &a {x: 1}\nb: *a\nc: {<<: *a, y: 2}", "")["c"] == {"x": 1, "y": 2}


def test_what_a_terminal_would_obey_is_marked_and_what_is_long_is_cut(capture_folder: Path) -> None:
    listing = read_listing(capture_folder)
    listing |= {"devices": {"camera": "\x1b]0;title\x07" + "x" * 5000, "lens": [["a"] * 50] * 5}, "by\x9b31m": 1}
    (capture_folder / "capture.yaml").write_text(flow_yaml(listing))
    about = identity(open_capture(capture_folder).metadata)
    assert about["camera"].startswith("\N{REPLACEMENT CHARACTER}]0;title\N{REPLACEMENT CHARACTER}xxx")
    assert about["by\N{REPLACEMENT CHARACTER}31m"] == "1"
    assert max(map(len, about.values())) <= 200


def test_many_unknown_keys_are_told_on_a_screen(tmp_path: Path) -> None:
    from scanner.configuration import load_config

    path = tmp_path / "room.yaml"
    path.write_text("\n".join(f"k{i}{'k' * 500}: 1" for i in range(1500)))
    with pytest.raises(InputError, match="and 1,488 more of the kind") as caught:
        load_config(path)
    assert len(str(caught.value).splitlines()) == 13
    assert max(map(len, str(caught.value).splitlines())) < 1500


def chunk(name: bytes, content: bytes) -> bytes:
    """A part of a PNG."""
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))


def palette_png(width: int, height: int) -> bytes:
    """A PNG of one colour, which is next to nothing on the disk."""
    compressor = zlib.compressobj(9)
    row = bytes(1 + (width + 7) // 8)
    pixels = b"".join(compressor.compress(row * 64) for _ in range(height // 64)) + compressor.flush()
    header = struct.pack(">IIBBBBB", width, height, 1, 3, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"PLTE", bytes(6)), (b"IDAT", pixels), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*each) for each in chunks)


def long_chunk() -> bytes:
    """A PNG one of whose chunks promises 2 GB."""
    whole = palette_png(64, 64)
    at = whole.index(b"IDAT") - 4
    return whole[:at] + b"\x7f\xff\xff\xf0" + whole[at + 4 :]


def unmeasured_png() -> bytes:
    """A huge PNG whose comment is broken: readers that look at it say no size, and OpenCV reads the pixels."""
    whole = palette_png(32704, 32704)
    at = whole.index(b"PLTE") - 4
    return whole[:at] + chunk(b"pHYs", b"1") + whole[at:]


def tiff(size: int, strips: int, bits: int, compression: int, strip: bytes) -> bytes:
    """A grey TIFF all of whose strips are at the same place."""
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
    """A small image whose header, at a marker, says that it is huge."""
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


IMAGES: dict[str, tuple[bytes, str]] = {
    "PNG that Pillow gives up": (unmeasured_png(), "32704 × 32704 pixels, which would take 3,209 MB"),
    "TIFF of 32 bits": (tiff(14_999, 1, 32, 5, bytes(100)), "which would take 900 MB"),
    "TIFF, shared strips": (tiff(500, 500, 8, 8, zlib.compress(bytes(5_000_000))), "unpack to more than an image has"),
    "JPEG 2000": (resized("JPEG2000", b"\xff\x4f\xff\x51\0\x2f\0\0", ">II", no_jp2=True), "which would take 3,375 MB"),
    "progressive JPEG": (resized("JPEG", b"\xff\xc2\0\x11\x08", ">HH", progressive=True), "would take 1,350 MB"),
    "JPEG written over": (many_scans(), "its pixels are written 20,00. times over"),
    "GIF": (resized("GIF", b"GIF87a", "<HH"), "14999 × 14999 pixels, which would take"),
    "palette PNG": (palette_png(32704, 32704), "32704 × 32704 pixels, which would take 3,209 MB"),
    "PGM header": (b"P5\n52000 52000\n255\n" + bytes(1000), "52000 × 52000 pixels"),
    "16-bit PPM header": (b"P6\n14000 14000\n65535\n" + bytes(1000), "14000 × 14000 pixels"),
    "BMP": (b"BM" + struct.pack("<IIIIiiHHIIiiII", 70, 0, 54, 40, 30000, 30000, 1, 24, *[0] * 6), "30000 × 30000"),
    "long chunk": (long_chunk(), "truncated"),
}  # fmt: skip


@pytest.mark.parametrize("name", IMAGES)
def test_a_huge_image_is_refused_by_its_header(tmp_path: Path, name: str) -> None:
    data, words = IMAGES[name]
    path = tmp_path / "frame.png"
    path.write_bytes(data)
    with little_memory(), pytest.raises(InputError, match=words):
        read_image(path)


def test_a_frame_far_beyond_its_camera_is_refused_by_its_header(capture_folder: Path) -> None:
    frame = capture_folder / read_listing(capture_folder)["frames"][0]["file"]
    frame.write_bytes(palette_png(12800, 12800))
    with little_memory(), pytest.raises(InputError, match="would take 492 MB of memory; expected no more than 100 MB"):
        list(open_capture(capture_folder).stream().frames)


def test_a_photo_of_200_megapixels_is_no_bomb(tmp_path: Path) -> None:
    path = tmp_path / "photo.png"
    cv2.imwrite(str(path), np.zeros((12_240, 16_320), np.uint8), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    (photo,) = read_photos([path])
    assert (photo.size, photo.reduced) == ((8_160, 6_120), 2)


@pytest.mark.parametrize(("codes_alone", "told"), [(False, "70000.0 GB"), (True, "152000.0 GB")])
def test_frames_that_nothing_could_decode_are_told_before(codes_alone: bool, told: str) -> None:
    refuse_more_than_there_is((2048, 2448), codes_alone=codes_alone)
    if Path("/proc/meminfo").exists():
        with pytest.raises(InputError, match=f"take about {told} of memory to decode"):
            refuse_more_than_there_is((1_000_000, 1_000_000), codes_alone=codes_alone)


def npz(path: Path, members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
    return path


def npy(array: Any) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asarray(array), allow_pickle=False)
    return stream.getvalue()


def header(text: str, rest: bytes = b"") -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode() + rest


FEW = {"camera_px": npy(np.ones((4, 2))), "projector_px": npy(np.ones((4, 2)))}
CLAIMS = "{'descr': '<f8', 'fortran_order': False, 'shape': %s}\n"
MATCHES: dict[str, tuple[dict[str, bytes], str]] = {
    "numbers that are not there": ({"camera_px": header(CLAIMS % "(100000000000, 2)")}, "does not have the numbers"),
    "a shape beyond any integer": ({"camera_px": header(CLAIMS % f"({10**30}, 2)")}, "does not have the numbers"),
    "a negative shape": ({"camera_px": header(CLAIMS % "(-3, 2)")}, "damaged"),
    "a shape of words": ({"camera_px": header(CLAIMS % "('a', 2)")}, "damaged"),
    "no end of brackets": ({"camera_px": header(CLAIMS % ("(" * 3000))}, "damaged"),
    "no Python": ({"camera_px": header("{'descr': \n")}, "damaged"),
    "a type that is none": ({"camera_px": header(CLAIMS.replace("<f8", "|O9") % "(1, 2)")}, "damaged|pickled"),
    "faces beyond any label": ({"face": npy(np.full(4, 2**40))}, "'face' must hold -1 for none and labels from 0"),
    "planes beyond the universe": ({"camera_px": npy(np.full((4, 2), 1e300))}, "must be pixels of an image"),
    "a sigma of nothing": ({"sigma_px": npy(np.full(4, 1e-300))}, "must be standard deviations in pixels"),
}


@pytest.mark.parametrize("name", MATCHES)
def test_hostile_matches_are_refused(tmp_path: Path, name: str) -> None:
    changed, words = MATCHES[name]
    with little_memory(), pytest.raises(InputError, match=words):
        read_matches(npz(tmp_path / "m.npz", FEW | changed))


def test_matches_that_unpack_to_gigabytes_are_refused(tmp_path: Path) -> None:
    path = npz(tmp_path / "m.npz", FEW | {"camera_px": npy(np.zeros((17_000_000, 2)))})
    assert path.stat().st_size < 1_000_000
    with little_memory(), pytest.raises(InputError, match="would take 272 MB of memory"):
        read_matches(path)


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2, zipfile.ZIP_DEFLATED])
def test_damaged_compressed_matches_are_refused(tmp_path: Path, method: int) -> None:
    path = npz(tmp_path / "m.npz", FEW, method)
    data = bytearray(path.read_bytes())
    refused = 0
    for at in range(40, len(data) - 200, 7):
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x5A]) + data[at + 1 :])
        try:
            read_matches(path)
        except InputError:
            refused += 1
    assert refused > 10


def header_of(count: str, **types: str) -> bytes:
    names = dict.fromkeys(("x", "y", "z", "nx", "ny", "nz"), "float") | dict.fromkeys(("red", "green", "blue"), "uchar")
    lines = [f"property {kind} {name}" for name, kind in (names | types).items()]
    start = ["ply", "format binary_little_endian 1.0", f"element vertex {count}", *lines, "end_header"]
    return "".join(f"{line}\n" for line in start).encode()


POINT = struct.pack("<6f3B", 1, 2, 3, 0, 0, -1, 4, 5, 6)
CLOUDS: dict[str, tuple[bytes, str]] = {
    "a count of 5,000 digits": (header_of("9" * 5000), "begins with its vertices"),
    "a count beyond any memory": (header_of("999999999999"), "would take"),
    "fewer points than promised": (header_of("100") + POINT, "truncated"),
    "no coordinates": (header_of("1") + struct.pack("<f", np.nan) + POINT[4:], "no finite numbers"),
    "infinite coordinates": (header_of("1") + struct.pack("<f", np.inf) + POINT[4:], "no finite numbers"),
    "fractional matches": (header_of("1", match="float") + POINT + bytes(4), "numbers of matches to be whole"),
}


@pytest.mark.parametrize("name", CLOUDS)
def test_hostile_clouds_are_refused(tmp_path: Path, name: str) -> None:
    data, words = CLOUDS[name]
    (tmp_path / "cloud.ply").write_bytes(data)
    with little_memory(), pytest.raises(InputError, match=words):
        read_cloud(tmp_path / "cloud.ply")


def fifo(path: Path) -> None:
    os.mkfifo(path)


def device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def listener(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as found:
        found.bind(str(path))


def holes(path: Path) -> None:
    path.touch()
    os.truncate(path, 300_000_000)


READERS: dict[str, Callable[[Path], object]] = {
    "frame.png": read_image,
    "photo.jpg": lambda path: read_photos([path]),
    "cloud.ply": read_cloud,
    "matches.npz": read_matches,
    "room.yaml": read_yaml,
    "calibration.yaml": read_calibration,
}


@pytest.mark.parametrize("make", [fifo, device, listener, holes, Path.mkdir])
@pytest.mark.parametrize("name", READERS)
def test_only_regular_files_are_read(tmp_path: Path, monkeypatch: Any, name: str, make: Callable[[Path], None]) -> None:
    monkeypatch.chdir(tmp_path)  # a socket's path must be short
    make(Path(name))
    with little_memory(), pytest.raises(InputError):
        READERS[name](Path(name))


def test_a_listing_outside_of_the_capture_is_refused(capture_folder: Path) -> None:
    (capture_folder / "capture.yaml").rename(capture_folder.parent / "elsewhere.yaml")
    (capture_folder / "capture.yaml").symlink_to(capture_folder.parent / "elsewhere.yaml")
    with pytest.raises(InputError, match="a link that leads out of the capture folder"):
        open_capture(capture_folder)


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
def test_whole_jpegs_of_any_size_are_read(tmp_path: Path, size: tuple[int, int], interval: int) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (*size, 3)).astype(np.uint8)
    for channels in (pixels, pixels[..., 0]):
        data = cv2.imencode(".jpg", channels, [cv2.IMWRITE_JPEG_RST_INTERVAL, interval])[1].tobytes()
        (tmp_path / "a.jpg").write_bytes(data + b"and whatever a phone adds")
        assert read_image(tmp_path / "a.jpg").shape == channels.shape


@pytest.mark.parametrize("command", ["photos", "room"])
def test_links_in_a_circle_are_refused_by_name(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, circle = tmp_path / "rig.yaml", tmp_path / "circle"
    config.write_text("camera: {width: 48, height: 32}\nprojector: {width: 48, height: 32}\n")
    circle.symlink_to("circle")
    given = [str(circle), str(tmp_path / "other"), "--config", str(config), "--out", str(tmp_path / "out")]
    assert main([command, *given]) == 2
    assert str(circle) in capsys.readouterr().err
