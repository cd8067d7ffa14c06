"""The content of every kind of file that the program writes, as dicts, lists, words, numbers and arrays.

What differs between two runs of the same program is left out here, by name: when something was done and how long it
took, and numbers that are drawn to be unique.
"""

import csv
import json
import re
import struct
import zipfile
from base64 import b64decode
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray


@dataclass(frozen=True)
class Lines:
    """Lines of a text that is read from top to bottom."""

    lines: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Unordered:
    """Triangles in any order, as threads finish with them.

    `points` (N, K): positions and everything else that is known of each, no two alike; `triangles` (T, 3): indices.
    """

    points: NDArray[np.float32]
    triangles: NDArray[np.intp]


# What differs between two runs of one program, in any text, and what is read instead.
_VARYING = [
    (re.compile(pattern, re.MULTILINE), instead)
    for pattern, instead in (
        # When it was made, in ISO format, in a report, in a log; modules, which the log names, are moved.
        (r"^\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} (\w+) [\w.]+:", r"\1:"),
        (r"\d{4}-\d\d-\d\d(?:T|, | )\d\d:\d\d(?::\d\d(?:\.\d+)?)?(?: UTC|\+00:00|Z)?", "DATE"),
        # Where a refusal was raised, in a log: in which checkout, at which line.
        (r'^  File ".*", line \d+, in .*\n(?:    .*\n)*', ""),
        # The folder in which a case runs, in a batch's table.
        (r"(?<![\w./+=-])/[\w./-]*/\.partial-\w+/[\w.-]+/", ""),
        # How long a check watched the rig, and what a batch took.
        (r"within \d+ s ", "within some s "),
        (r"^[\d.]+ s, [\d.]+ a second$", "some s"),
        # Of live clouds: rate and delay, every other second; the number of rounds before the loop ended.
        (r"^(?:\S+ clouds a second|The first cloud), .*\n", ""),
        (r"^\d+ clouds(?:, \d+ rounds came while .*)?\.$", "Some clouds."),
        # Identifiers of an E57 file's scans.
        (r"(<StringNode 'guid'>: )\{[\w-]+\}", r"\1some"),
    )
]
_OF_A_RUN = {"asked", "seconds", "worker"}  # keys of a batch's rows; what was asked for has absolute paths in it
_SECONDS = re.compile(r"(<td class=\"number\">)[\d.]+(</td>\s*</tr>)")  # of a capture, on a batch's page
_NUMBER = re.compile(r"(?<![\w.#])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")
_DATA_URI = re.compile(r"data:(image/(?:png|jpeg));base64,([A-Za-z0-9+/=]+)")


def read(path: Path) -> Any:
    """The content of a file. Of a kind that has no reader: its bytes."""
    reader = _BY_NAME.get(path.name) or _BY_ENDING.get(path.suffix.lower())
    return path.read_bytes() if reader is None else reader(path)


def _steady(text: str) -> str:
    for pattern, instead in _VARYING:
        text = pattern.sub(instead, text)
    return text


def _text(path: Path) -> str:
    return _steady(path.read_text(encoding="utf-8"))


def _rows(value: Any) -> Any:
    """Rows of a batch, without what is of this run."""
    if isinstance(value, dict):
        return {key: _rows(inner) for key, inner in value.items() if key not in _OF_A_RUN}
    if isinstance(value, list):
        return [_rows(inner) for inner in value]
    return _steady(value) if isinstance(value, str) else value


def _yaml(path: Path) -> Any:
    text = _text(path)
    if text.startswith("%YAML:") or "!!opencv-matrix" in text:  # OpenCV's, which PyYAML does not read
        return numbers_apart(text)
    return yaml.safe_load(text)


def _json(path: Path) -> Any:
    return _rows(json.loads(_text(path)))


def _csv(path: Path) -> Any:
    return _rows([*csv.DictReader(_text(path).splitlines())])


def _lines(path: Path) -> Lines:
    return Lines(tuple(_text(path).splitlines()))


def numbers_apart(text: str) -> dict[str, Any]:
    """A text with # in the place of its numbers, and these."""
    numbers = np.array([float(number) for number in _NUMBER.findall(text)])
    return {"text": Lines(tuple(_NUMBER.sub("#", text).splitlines())), "numbers": numbers}


def _numbers_apart(path: Path) -> dict[str, Any]:
    return numbers_apart(_text(path))


def _dxf(path: Path) -> dict[str, Any]:
    """Without the variables of the header that state when and by which library it was made, and unique identifiers."""
    made = r"  9\n\$(?:TD\w+|\w+GUID|CUSTOMPROPERTY\w*)\n *\d+\n.*\n"
    return numbers_apart(re.sub(made, "", _text(path)))


def _html(path: Path) -> dict[str, Any]:
    """The words of a page, its pictures, and everything else: elements, drawings, styles, scripts."""
    text = _text(path)
    pictures = [_pixels(b64decode(data)) for _, data in _DATA_URI.findall(text)]
    text = _SECONDS.sub(r"\1\2", _DATA_URI.sub("PICTURE", text))
    words = re.sub(r"<(style|script)\b.*?</\1>|<[^>]*>", "\n", text, flags=re.DOTALL)
    lines = (" ".join(line.split()) for line in words.splitlines())
    markup = re.findall(r"<(?:style|script)\b.*?</(?:style|script)>|<[^>]*>", text, flags=re.DOTALL)
    return {
        "words": Lines(tuple(line for line in lines if line)),
        "pictures": pictures,
        "markup": numbers_apart("\n".join(markup)),
    }


def _npz(path: Path) -> dict[str, Any]:
    with np.load(path) as arrays:
        return dict(arrays)


def _pixels(data: bytes) -> Any:
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return data if pixels is None else pixels


def _image(path: Path) -> Any:
    return _pixels(path.read_bytes())


_PLY_TYPES = {"float": "<f4", "double": "<f8", "uchar": "u1", "int": "<i4", "uint": "<u4"}


def _ply(path: Path) -> dict[str, Any]:
    """Binary little endian; lists are of triangles."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    content: dict[str, Any] = {"comments": Lines(())}
    elements: list[tuple[str, int, list[tuple[str, Any]]]] = []
    for line in header.decode("ascii").splitlines():
        match line.split():
            case ["element", name, count]:
                elements.append((name, int(count), []))
            case ["property", "list", count, kind, name]:
                elements[-1][2].extend([(f"{name} count", _PLY_TYPES[count]), (name, (_PLY_TYPES[kind], 3))])
            case ["property", kind, name]:
                elements[-1][2].append((name, _PLY_TYPES[kind]))
            case ["comment", *_]:
                content["comments"] = Lines((*content["comments"].lines, line))
    start = 0
    for element, number, fields in elements:
        rows = np.frombuffer(body, np.dtype(fields), number, start)
        start += rows.nbytes
        content[element] = {name: rows[name] for name, _ in fields}
    return content | {"rest": body[start:]}


_GLTF_TYPES = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}


def _glb(path: Path) -> dict[str, Any]:
    """Document, arrays and pictures of a binary glTF file."""
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    document = json.loads(data[20 : 20 + length])
    binary = data[28 + length :]

    def part(number: int) -> bytes:
        view = document["bufferViews"][number]
        begin = view.get("byteOffset", 0)
        return binary[begin : begin + view["byteLength"]]

    arrays = [
        np.frombuffer(part(accessor["bufferView"]), _GLTF_TYPES[accessor["componentType"]])
        for accessor in document["accessors"]
    ]
    pictures = [_pixels(part(image["bufferView"])) for image in document.get("images", [])]
    return {"document": document, "arrays": arrays, "pictures": pictures}


def _room_mesh(path: Path) -> dict[str, Any]:
    """The same of a room: Open3D extracts its triangles in the order in which threads finish with them."""
    content = _glb(path)
    arrays = content.pop("arrays")
    meshes = []
    for piece in content["document"]["meshes"][0]["primitives"]:
        columns = [arrays[number] for number in piece["attributes"].values()]
        count = content["document"]["accessors"][piece["attributes"]["POSITION"]]["count"]
        every_point = np.concatenate([column.reshape(count, -1).astype(np.float32) for column in columns], axis=1)
        points, index = np.unique(every_point, axis=0, return_inverse=True)
        meshes.append(Unordered(points, index.reshape(-1)[arrays[piece["indices"]]].reshape(-1, 3)))
    return content | {"meshes": meshes}


def _stl(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    rows = np.frombuffer(data, np.dtype([("corners", "<f4", 12), ("rest", "<u2")]), offset=84)
    return {"header": data[:84], "corners": rows["corners"]}


def _zip(path: Path) -> dict[str, Any]:
    with zipfile.ZipFile(path) as file:
        return {name: numbers_apart(file.read(name).decode()) for name in file.namelist()}


def _e57(path: Path) -> dict[str, Any]:
    """Poses and points; a file also has the time at which it was made, and unique identifiers."""
    import pye57

    file = pye57.E57(str(path))
    headers = (_steady("\n".join(file.get_header(number).pretty_print())) for number in range(file.scan_count))
    scans = [
        {"points": file.read_scan_raw(number), "header": Lines(tuple(header.splitlines()))}
        for number, header in enumerate(headers)
    ]
    return {"scans": scans}


def _parquet(path: Path) -> Any:
    import pyarrow.parquet

    return _rows(pyarrow.parquet.read_table(path).to_pylist())


def _pdf(path: Path) -> bytes:
    return re.sub(rb"/(CreationDate|ModDate) ?\([^)]*\)", b"", path.read_bytes())


_BY_NAME: dict[str, Callable[[Path], Any]] = {"stdout.txt": _lines, "stderr.txt": _lines, "room.glb": _room_mesh}
_BY_ENDING: dict[str, Callable[[Path], Any]] = {
    ".3mf": _zip,
    ".csv": _csv,
    ".dxf": _dxf,
    ".e57": _e57,
    ".glb": _glb,
    ".html": _html,
    ".jpg": _image,
    ".json": _json,
    ".log": _lines,
    ".npz": _npz,
    ".obj": _numbers_apart,
    ".parquet": _parquet,
    ".pdf": _pdf,
    ".ply": _ply,
    ".png": _image,
    ".stl": _stl,
    ".svg": _numbers_apart,
    ".tif": _image,
    ".txt": _numbers_apart,
    ".yaml": _yaml,
}
