"""Check that an image file is complete and undamaged, as far as its format allows.

OpenCV decodes, and accepts much that is damaged. Pillow is a second opinion on TIFF, where it detects damage in
compressed pixels. In a format without checksums, a flipped bit is a wrong pixel, which cannot be detected.

Check that the compressed data of a JPEG decode to exactly its pixels (ITU-T T.81, annexes B and F).

JPEG has no checksums, and decoders accept almost anything. But a flipped bit shifts all codes after it: sooner or later
an undefined code follows, or the data end before or after the last pixel. Only sequential Huffman coding is checked,
which cameras write; other kinds pass unchecked.
"""

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from calib.numerics import Ints, compiled
from hw.jpeg import START, is_whole_jpeg
from scanner.io.given_file import MOST_IMAGE_BYTES
from scanner.io.image_size import PNG_START, SCAN, UNREADABLE, segments

_SEQUENTIAL = (0xC0, 0xC1)
_OTHER_FRAMES = (0xC2, 0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF)
_TABLES, _SIZES, _SCAN, _INTERVAL, _END = 0xC4, _SEQUENTIAL, 0xDA, 0xDD, 0xD9
_TABLE_COUNT, _AC = 8, 4
_PROBLEMS = (
    None,
    "its compressed data contain a code that does not exist",
    "its compressed data end before its pixels",
    "its compressed data go on after its pixels",
)
_WITHOUT_CHECK = {"TIFF"}  # formats that OpenCV reads despite damage, which is reported here
_COMPRESSION, _DEFLATE = 259, (8, 32946)
_PARTS = ((273, 279), (324, 325))  # offsets and lengths, of strips and of tiles
_AT_ONCE_BYTES = 1_000_000
_MOST_SCANS = 100  # scans of a JPEG, each of which visits all pixels; encoders write at most 14
_NOT_DAMAGE = ("not available", "unknown", "unsupported", "not supported")


@dataclass
class _Read:
    """The headers read so far; `lookup` (8, 65536): length and symbol of the code at the beginning of 16 bits; `runs`:
    the same for as many AC codes as fit into 16 bits, with their coefficients: bits, places, and whether the block ends
    with them.
    """

    size: tuple[int, int] = (0, 0)
    factors: dict[int, tuple[int, int]] = field(default_factory=dict)
    lookup: NDArray[np.int32] = field(default_factory=lambda: np.zeros((_TABLE_COUNT, 1 << 16), np.int32))
    runs: NDArray[np.int32] = field(default_factory=lambda: np.zeros((_TABLE_COUNT, 1 << 16), np.int32))
    known: set[int] = field(default_factory=set)
    interval: int = 0


def problem_of_jpeg(data: bytes) -> str | None:
    """Return the defect of the compressed data of a JPEG; None if there is none, or for unchecked kinds."""
    read, at = _Read(), 2
    pixels = np.frombuffer(data, np.uint8)
    while at + 4 <= len(data):
        if data[at] != 0xFF:
            return None  # garbage between segments is left to the decoder
        marker = data[at + 1]
        if marker in (0xFF, 0x01) or 0xD0 <= marker <= 0xD8:
            at += 1 if marker == 0xFF else 2
            continue
        if marker == _END or marker in _OTHER_FRAMES:
            return None
        length = int.from_bytes(data[at + 2 : at + 4], "big")
        segment, at = data[at + 4 : at + 2 + length], at + 2 + length
        try:
            if marker == _SCAN:
                followed = _follow(read, pixels, segment, at)
                if followed is None:
                    return None
                at, problem = followed
                if problem:
                    return _PROBLEMS[problem]
            else:
                _note(read, marker, segment)
        except (LookupError, ValueError, ZeroDivisionError):
            return None  # an invalid header is left to the decoder
    return None


def _note(read: _Read, marker: int, segment: bytes) -> None:
    if marker in _SEQUENTIAL:
        read.size = int.from_bytes(segment[3:5], "big"), int.from_bytes(segment[1:3], "big")
        parts = [segment[6 + 3 * i : 9 + 3 * i] for i in range(segment[5])]
        read.factors = {part[0]: (part[1] >> 4, part[1] & 15) for part in parts}
    elif marker == _TABLES:
        at = 0
        while at < len(segment):
            counts = segment[at + 1 : at + 17]
            table = _AC * (segment[at] >> 4) + (segment[at] & 3)
            symbols = segment[at + 17 : at + 17 + sum(counts)]
            read.lookup[table], read.runs[table] = _lookup(counts, symbols)
            read.known.add(table)
            at += 17 + sum(counts)
    elif marker == _INTERVAL:
        read.interval = int.from_bytes(segment[:2], "big")


@lru_cache(_TABLE_COUNT)  # a camera's frames mostly share their tables
def _lookup(counts: bytes, symbols: bytes) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return for each 16-bit word the length of the code at its beginning, times 256, plus its symbol; 0 where no code
    begins. And its `_runs`.
    """
    table, first, number = np.zeros(1 << 16, np.int32), 0, 0
    for length, count in enumerate(counts, start=1):
        for _ in range(count):
            step = 1 << (16 - length)
            table[first : first + step] = length << 8 | symbols[number]
            first, number = first + step, number + 1
    return table, _runs(table)


@compiled
def _runs(lookup: NDArray[np.int32]) -> NDArray[np.int32]:
    """For each 16 bits the codes of AC that are whole in them, with their coefficients: 128 times as many bits as they
    have, the places that they go on by, and 64 more if the block ends with the last; 0 for none.
    """
    codes = np.zeros(len(lookup), np.int32)
    for bits in range(len(lookup)):
        used, places = 0, 0
        while True:
            # Zeros follow the last bit; no complete code in the 16 bits reaches them.
            code = lookup[(bits << used) & 0xFFFF]
            symbol = code & 255
            more = (code >> 8) + (symbol & 15)
            on = (symbol >> 4) + 1
            if code == 0 or used + more > 16 or places + on >= 64:
                break
            used += more
            if symbol == 0:
                places |= 64
                break
            places += on
        codes[bits] = used << 7 | places
    return codes


def _follow(read: _Read, data: NDArray[np.uint8], segment: bytes, at: int) -> tuple[int, int] | None:
    """Return where the data of a scan end, and their defect; None if that cannot be determined."""
    parts = [segment[1 + 2 * i : 3 + 2 * i] for i in range(segment[0])]
    tables = {part[0]: (part[1] >> 4 & 3, _AC + (part[1] & 3)) for part in parts}
    if not all(table in read.known for pair in tables.values() for table in pair) or min(read.size) < 1:
        return None
    across, down = (max(factor[i] for factor in read.factors.values()) for i in (0, 1))
    (width, height), blocks = read.size, []
    if len(parts) > 1:
        units = _fitting(width, 8 * across) * _fitting(height, 8 * down)
        for name, pair in tables.items():
            blocks += [pair] * (read.factors[name][0] * read.factors[name][1])
    else:
        ((name, pair),) = tables.items()
        h, v = read.factors[name]
        units = _fitting(_fitting(width * h, across), 8) * _fitting(_fitting(height * v, down), 8)
        blocks = [pair]
    end, problem = _follow_blocks(data, at, np.array(blocks, np.int64), units, read.interval, read.lookup, read.runs)
    return int(end), int(problem)


def _fitting(length: int, step: int) -> int:
    """How many steps reach to the end."""
    return (length + step - 1) // step


@compiled
def _follow_blocks(
    data: NDArray[np.uint8],
    at: int,
    blocks: Ints,
    units: int,
    interval: int,
    lookup: NDArray[np.int32],
    runs: NDArray[np.int32],
) -> tuple[int, int]:
    """Where `units` of `blocks` (n, 2: tables of DC and AC) end that begin `at`; 0, or the number of the problem."""
    held, count, size = np.int64(0), 0, len(data)  # unused bits, and their number
    for unit in range(units):
        if interval > 0 and unit > 0 and unit % interval == 0:
            while at < size - 1 and data[at] == 0xFF and data[at + 1] == 0xFF:
                at += 1
            if count >= 8 or at >= size - 1 or data[at] != 0xFF:
                return at, 3
            if data[at + 1] != 0xD0 + (unit // interval - 1) % 8:
                return at, 2
            at, held, count = at + 2, np.int64(0), 0
        for block in range(len(blocks)):
            number = 0
            while number < 64:
                # A code has 16 bits at most, and as many bits of a coefficient may follow it.
                if count < 32 and at + 4 <= size:
                    word, is_plain = np.int64(0), True  # 255 is followed by a marker, or by a stuffed zero
                    for ahead in range(4):
                        word = word << 8 | np.int64(data[at + ahead])
                        is_plain &= data[at + ahead] != 0xFF
                    if is_plain:
                        held, count, at = held << 32 | word, count + 32, at + 4
                while count < 32 and at < size and (data[at] != 0xFF or (at + 1 < size and data[at + 1] == 0)):
                    held, count = (held << 8 | data[at]) & 0xFFFFFFFFFF, count + 8
                    at += 2 if data[at] == 0xFF else 1
                bits = held >> (count - 16) if count >= 16 else (held << (16 - count) | (1 << (16 - count)) - 1)
                if number > 0 and count >= 16:
                    run = runs[blocks[block, 1], bits]
                    places = run & 63
                    if run > 0 and number + places < 64:
                        count -= run >> 7
                        held &= (1 << count) - 1
                        number = 64 if run & 64 else number + places
                        continue
                code = lookup[blocks[block, 1 if number else 0], bits & 0xFFFF]
                if code == 0:
                    return at, 1 if count >= 16 else 2
                symbol = code & 255
                used = (code >> 8) + (symbol & 15)
                if used > count:
                    return at, 2
                count -= used
                held &= (1 << count) - 1
                if number == 0:
                    number = 1
                elif symbol == 0:
                    number = 64
                elif symbol == 0xF0:
                    number += 16
                else:
                    number += (symbol >> 4) + 1
                    if number > 64:
                        return at, 1
    # Remaining whole bytes, except those that pad up to the next marker.
    while count >= 8:
        count -= 8
        rest = held >> count & 255
        if rest != 0 and rest != 255:
            return at, 3
    while at < size - 1 and not (data[at] == 0xFF and data[at + 1] != 0 and data[at + 1] != 0xFF):
        if data[at] != 0 and data[at] != 0xFF:
            return at, 3
        at += 1
    return at, 0


def damage(data: bytes) -> str | None:
    """Return the damage of an image file, even one that OpenCV accepts; None if none is known."""
    if data.startswith(PNG_START):
        return _damage_of_png(data)
    if data.startswith(START):
        if not is_whole_jpeg(data):
            return "truncated, its end is missing"
        scans = sum(marker == SCAN for marker, _ in segments(data))
        return problem_of_jpeg(data) if scans <= _MOST_SCANS else f"its pixels are written {scans:,} times over"
    try:
        with Image.open(BytesIO(data)) as image:
            if image.format not in _WITHOUT_CHECK:
                return None
            return _damage_of_tiff(image, data)
    except (UnidentifiedImageError, *UNREADABLE):
        return None


def _damage_of_png(data: bytes) -> str | None:
    """Whether its chunks (length, name, content, check sum) reach to the last; OpenCV makes room for any length."""
    at = len(PNG_START)
    while at + 12 <= len(data):
        length, name = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        at += 12 + length
        if name == b"IEND" and at <= len(data):
            return None
    return "truncated, its end is missing"


def _damage_of_tiff(image: Image.Image, data: bytes) -> str | None:
    tags = getattr(image, "tag_v2", {})
    if tags.get(_COMPRESSION) in _DEFLATE:
        return _damage_of_deflated(tags, data)
    try:
        image.load()
    except OSError as error:
        return None if any(words in str(error) for words in _NOT_DAMAGE) else f"its pixels do not decode ({error})"
    return None


def _damage_of_deflated(tags: Mapping[int, Any], data: bytes) -> str | None:
    """Strips or tiles end in a check sum, which neither library asks for once it has all pixels."""
    remaining = MOST_IMAGE_BYTES  # for all strips together, which may share one place
    for offsets, lengths in _PARTS:
        for offset, length in zip(tags.get(offsets, ()), tags.get(lengths, ()), strict=False):
            unpacking = zlib.decompressobj()
            try:
                for unpacked in _unpacked(unpacking, memoryview(data)[offset : offset + length]):
                    remaining -= unpacked
                    if remaining < 0:
                        return "its parts unpack to more than an image has"
            except zlib.error as error:
                return f"its pixels do not decode ({error})"
            if not unpacking.eof:
                return "truncated, the end of its pixels is missing"
    return None


def _unpacked(unpacking: Any, part: memoryview) -> Iterator[int]:
    """Count the decompressed bytes in small pieces, keeping none."""
    for start in range(0, len(part), _AT_ONCE_BYTES):
        packed: Any = part[start : start + _AT_ONCE_BYTES]
        while packed and not unpacking.eof:
            yield len(unpacking.decompress(packed, _AT_ONCE_BYTES))
            packed = unpacking.unconsumed_tail
    yield len(unpacking.flush())
