"""`matches.npz`: camera and projector pixels that belong together, from this program's decoder or from another one."""

import lzma
import math
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from calib.geometry import NO_FACE, Matches
from calib.numerics import Floats, Ints
from scanner.errors import InputError
from scanner.io.atomic_file import new_file
from scanner.io.given_file import opened, refuse_bomb
from scanner.shown_text import harmless, shortened

MATCHES_FILE = "matches.npz"

_MEASURED = "projector_measured"

# Exceptions of zipfile, its decompressors and NumPy's header reader, which is Python's parser.
_UNREADABLE = (
    *(
        OSError,
        EOFError,
        RuntimeError,
        ValueError,
        TypeError,
        LookupError,
        ArithmeticError,
        AttributeError,
        SyntaxError,
    ),
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, tokenize.TokenError, MemoryError),
)
# Decoders are accurate to thousandths of a pixel; a sigma beyond these bounds is not one in pixels.
_LEAST_SIGMA_PX, _MOST_SIGMA_PX = 1e-9, 1e6
_FARTHEST_PX = 1e6

_REQUIRED = ("camera_px", "projector_px")
_EXPECTED = {  # expected types, and the letters of the numpy types accepted
    "camera_px": ("numbers", "fiu"),
    "projector_px": ("numbers", "fiu"),
    "face": ("whole numbers", "iu"),
    "sigma_px": ("numbers", "fiu"),
    "plane": ("whole numbers", "iu"),
    _MEASURED: ("two truth values", "b"),
}


def write_matches(
    path: Path, matches: Matches, plane: Ints | None = None, only_axis: Literal["x", "y"] | None = None
) -> None:
    """Write matches with `plane` (N,), the plane of each, −1 for none. Raises OSError.

    `only_axis`: the only measured coordinate of the projector; the other follows from a calibration.
    """
    arrays: dict[str, Any] = {"camera_px": matches.camera_px, "projector_px": matches.projector_px}
    if matches.face is not None:
        arrays["face"] = _in_few_bytes(matches.face)
    if matches.sigma_px is not None:
        arrays["sigma_px"] = matches.sigma_px
    if plane is not None:
        arrays["plane"] = _in_few_bytes(plane)
    if only_axis is not None:
        arrays[_MEASURED] = np.array([only_axis == "x", only_axis == "y"])
    with new_file(path, overwrite=True) as partial, partial.open("wb") as file:
        np.savez(file, **arrays)


def _in_few_bytes(labels: Ints) -> Ints:
    """Labels from −1 up as the smallest signed numbers that hold them."""
    return labels.astype(np.min_scalar_type(-1 - int(labels.max(initial=0))))


def read_matches(path: Path) -> Matches:
    """Read a matches file, or that of a result folder.

    Raises InputError if it is missing or damaged, holds pickled objects, lacks an array, or has one of a wrong shape
    or type.
    """
    file = _file(path)
    arrays = _arrays_in(file)
    for name in _REQUIRED:
        if name not in arrays:
            raise InputError(f"{file}: the array '{name}' is missing")
    sigma_px = arrays.get("sigma_px")
    try:
        matches = Matches(
            _numbers(arrays["camera_px"]),
            _numbers(arrays["projector_px"]),
            _labels(file, "face", arrays.get("face")),
            None if sigma_px is None else _numbers(sigma_px),
        )
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error
    if len(matches) == 0:
        raise InputError(f"{file}: holds no matches")
    _refuse_far(file, matches)
    return matches


def _numbers(array: NDArray[Any]) -> Floats:
    with np.errstate(over="ignore"):  # a wider type becomes infinite, and is refused as such
        return array.astype(np.float64)


def _labels(file: Path, name: str, labels: NDArray[Any] | None) -> Ints | None:
    if labels is None:
        return None
    if labels.size and not (labels.min() >= NO_FACE and labels.max() <= np.iinfo(np.int32).max):
        span = f"{labels.min()} to {labels.max()}"
        raise InputError(f"{file}: '{name}' must hold {NO_FACE} for none and labels from 0, found {span}")
    return labels.astype(np.int32)


def _refuse_far(file: Path, matches: Matches) -> None:
    """Raise InputError for numbers that are no pixels."""
    for name, pixels in (("camera_px", matches.camera_px), ("projector_px", matches.projector_px)):
        if np.abs(pixels).max() > _FARTHEST_PX:
            raise InputError(f"{file}: '{name}' must be pixels of an image, found {np.abs(pixels).max():.3g}")
    sigma_px = matches.sigma_px
    if sigma_px is not None and not (sigma_px.min() >= _LEAST_SIGMA_PX and sigma_px.max() <= _MOST_SIGMA_PX):
        span = f"{sigma_px.min():.3g} to {sigma_px.max():.3g}"
        raise InputError(f"{file}: 'sigma_px' must be standard deviations in pixels, found {span}")


def read_planes(path: Path) -> Ints | None:
    """Which plane each match of a matches file is on, (N,), −1 for none; None if the file does not say.

    Raises InputError if the file is damaged, or says it of another number of matches.
    """
    arrays = _arrays_in(_file(path))
    plane, count = arrays.get("plane"), len(arrays.get("camera_px", ()))
    if plane is not None and plane.shape != (count,):
        raise InputError(f"{_file(path)}: plane must have the shape ({count},), found {plane.shape}")
    return _labels(_file(path), "plane", plane)


def read_only_axis(path: Path) -> Literal["x", "y"] | None:
    """The only one of the projector's coordinates that was measured, if a matches file says so."""
    measured = _arrays_in(_file(path)).get(_MEASURED)
    if measured is None or measured.all():
        return None
    return "x" if measured[0] else "y"


def refuse_one_axis(path: Path) -> None:
    """Raise InputError if one projector coordinate of a matches file was computed from a calibration.

    Calibrating from such matches would only reproduce that calibration, with sigmas that are too small.
    """
    if read_only_axis(path) is not None:
        raise InputError(
            f"{_file(path)}: only one of the projector's coordinates was measured, and the other follows from a "
            "calibration: these matches cannot tell whether it is right; capture with patterns along both axes"
        )


def _file(path: Path) -> Path:
    return path / MATCHES_FILE if path.is_dir() else path


def _arrays_in(file: Path) -> dict[str, NDArray[Any]]:
    if not file.exists():
        raise InputError(f"{file}: no such matches file")
    with opened(file) as stream:
        try:
            if not zipfile.is_zipfile(stream):
                raise InputError(f"{file}: expected an .npz file as numpy.savez writes it, found something else")
            with zipfile.ZipFile(stream) as archive:
                members = {name: member for name in _EXPECTED if (member := _member(archive, name))}
                refuse_bomb(file, stream, sum(member.file_size for member in members.values()))
                return {name: _array(file, archive, member, name) for name, member in members.items()}
        except _UNREADABLE as error:
            raise InputError(f"{file}: damaged: {shortened(harmless(str(error)))}") from error


def _member(archive: zipfile.ZipFile, name: str) -> zipfile.ZipInfo | None:
    return archive.NameToInfo.get(f"{name}.npy")


def _array(file: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo, name: str) -> NDArray[Any]:
    """Read one array, its header first: shape and type are trusted only if the file has as many bytes."""
    with archive.open(member) as stream:
        version = npy.read_magic(stream)
        shape, _, dtype = (npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0)(stream)
        expected, kinds = _EXPECTED[name]
        if dtype.hasobject:
            raise InputError(f"{file}: holds pickled objects, which are not read: save plain arrays")
        if dtype.kind not in kinds:
            raise InputError(f"{file}: '{name}' must be {expected}, found {dtype}")
        if math.prod(shape) * dtype.itemsize > member.file_size:
            raise InputError(f"{file}: damaged: '{name}' does not have the numbers that its header promises")
    with archive.open(member) as stream:
        return np.atleast_1d(npy.read_array(stream, allow_pickle=False))
