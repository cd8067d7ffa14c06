"""Small matches and clouds that would fill the memory or hold implausible numbers."""

import io
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanner.errors import InputError
from scanner.io import read_cloud, read_matches
from tests.support.little_memory import little_memory


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
