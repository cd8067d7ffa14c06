"""`matches.npz`: camera and projector pixels that belong together, from this program's decoder or from another one."""

import zipfile
import zlib
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from calib.geometry import NO_FACE, Matches
from calib.numerics import Ints
from scanner.errors import InputError
from scanner.io.atomic_file import new_file

MATCHES_FILE = "matches.npz"

_MEASURED = "projector_measured"

_REQUIRED = ("camera_px", "projector_px")
_EXPECTED = {  # what it must be, and numpy's letters for the types that are
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
    """Write matches with what is known of them; `plane` (N,): which plane each is on, −1 for none. Raises OSError.

    `only_axis`: the only one of the projector's coordinates that was measured, the other following from a calibration.
    """
    arrays: dict[str, Any] = {"camera_px": matches.camera_px, "projector_px": matches.projector_px}
    if matches.face is not None:
        arrays["face"] = matches.face
    if matches.sigma_px is not None:
        arrays["sigma_px"] = matches.sigma_px
    if plane is not None:
        arrays["plane"] = plane
    if only_axis is not None:
        arrays[_MEASURED] = np.array([only_axis == "x", only_axis == "y"])
    with new_file(path, overwrite=True) as partial, partial.open("wb") as file:
        np.savez(file, **arrays)


def read_matches(path: Path) -> Matches:
    """Read a matches file, or that of a result folder.

    Raises InputError if it is missing or damaged, holds pickled objects, lacks an array, or has one of a wrong shape
    or type.
    """
    file = _file(path)
    arrays = _load(file)
    for name in _REQUIRED:
        if name not in arrays:
            raise InputError(f"{file}: the array '{name}' is missing")
    face = arrays.get("face")
    if face is not None and face.size and face.min() < NO_FACE:
        raise InputError(f"{file}: 'face' must hold {NO_FACE} for none and labels from 0, found {face.min()}")
    sigma_px = arrays.get("sigma_px")
    try:
        matches = Matches(
            arrays["camera_px"].astype(np.float64),
            arrays["projector_px"].astype(np.float64),
            None if face is None else face.astype(np.int32),
            None if sigma_px is None else sigma_px.astype(np.float64),
        )
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error
    if len(matches) == 0:
        raise InputError(f"{file}: holds no matches")
    return matches


def read_planes(path: Path) -> Ints | None:
    """Which plane each match of a matches file is on, (N,), −1 for none; None if the file does not say.

    Raises InputError if the file is damaged, or says it of another number of matches.
    """
    arrays = _load(_file(path))
    plane, count = arrays.get("plane"), len(arrays.get("camera_px", ()))
    if plane is not None and plane.shape != (count,):
        raise InputError(f"{_file(path)}: plane must have the shape ({count},), found {plane.shape}")
    return None if plane is None else plane.astype(np.int32)


def refuse_one_axis(path: Path) -> None:
    """Raise InputError if a matches file says that one projector coordinate follows from a calibration.

    To calibrate from such matches would be to find that calibration again, and to look sure of it.
    """
    measured = _load(_file(path)).get(_MEASURED)
    if measured is not None and not measured.all():
        raise InputError(
            f"{_file(path)}: only one of the projector's coordinates was measured, and the other follows from a "
            "calibration: these matches cannot tell whether it is right; capture with patterns along both axes"
        )


def _file(path: Path) -> Path:
    return path / MATCHES_FILE if path.is_dir() else path


def _load(file: Path) -> dict[str, NDArray[Any]]:
    arrays = _arrays_in(file)
    for name, array in arrays.items():
        expected, kinds = _EXPECTED[name]
        if array.dtype.kind not in kinds:
            raise InputError(f"{file}: '{name}' must be {expected}, found {array.dtype}")
    return arrays


def _arrays_in(file: Path) -> dict[str, NDArray[Any]]:
    if not file.is_file():
        raise InputError(f"{file}: {'not a file' if file.exists() else 'no such matches file'}")
    try:
        if not zipfile.is_zipfile(file):
            raise InputError(f"{file}: expected an .npz file as numpy.savez writes it, found something else")
        with np.load(file, allow_pickle=False) as archive:
            return {name: np.atleast_1d(archive[name]) for name in archive.files if name in _EXPECTED}
    except ValueError as error:
        if "allow_pickle" in str(error):
            raise InputError(f"{file}: holds pickled objects, which are not read: save plain arrays") from error
        raise InputError(f"{file}: damaged: {error}") from error
    except (OSError, EOFError, RuntimeError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"{file}: damaged: {error}") from error
