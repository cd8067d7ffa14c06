import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as stn

from calib.geometry import Matches
from scanner.errors import InputError
from scanner.io.matches_file import read_matches, read_planes, write_matches

GOOD: dict[str, Any] = {"camera_px": np.ones((4, 2)), "projector_px": np.zeros((4, 2))}

pixels = stn.arrays(np.float64, (5, 2), elements=st.floats(-1e4, 1e4))


@given(
    pixels,
    pixels,
    st.none() | stn.arrays(np.int32, 5, elements=st.integers(-1, 5)),
    st.none() | stn.arrays(np.float64, 5, elements=st.floats(1e-3, 10)),
)
def test_matches_read_back_the_same(
    tmp_path_factory: pytest.TempPathFactory,
    camera_px: np.ndarray,
    projector_px: np.ndarray,
    face: np.ndarray | None,
    sigma_px: np.ndarray | None,
) -> None:
    path = tmp_path_factory.getbasetemp() / "matches.npz"
    write_matches(path, Matches(camera_px, projector_px, face, sigma_px))
    read = read_matches(path)
    for before, after in ((camera_px, read.camera_px), (face, read.face), (sigma_px, read.sigma_px)):
        np.testing.assert_array_equal(after, before)
        assert (after is None) == (before is None)


def test_a_result_folder_stands_for_its_matches(tmp_path: Path) -> None:
    np.savez(tmp_path / "matches.npz", **GOOD)
    assert len(read_matches(tmp_path)) == 4


def test_other_number_types_and_arrays_are_read(tmp_path: Path) -> None:
    np.savez_compressed(
        tmp_path / "m.npz",
        camera_px=np.ones((4, 2), np.float32),
        projector_px=np.ones((4, 2), ">i8"),
        face=np.zeros(4, np.uint8),
        comment=np.array(["of no interest"]),
    )
    matches = read_matches(tmp_path / "m.npz")
    assert matches.camera_px.dtype == matches.projector_px.dtype == np.float64
    assert matches.face is not None


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "no camera": ({"camera_px": None}, "'camera_px' is missing"),
    "no projector": ({"projector_px": None}, "'projector_px' is missing"),
    "another length": (
        {"projector_px": np.zeros((3, 2))},
        r"projector_px must have the shape \(4, 2\), found \(3, 2\)",
    ),
    "three columns": ({"camera_px": np.zeros((4, 3))}, r"camera_px must have the shape \(4, 2\)"),
    "one number": ({"camera_px": np.float64(3)}, "camera_px must have the shape"),
    "not a number": ({"camera_px": np.full((4, 2), np.nan)}, "camera_px must hold finite numbers"),
    "words": ({"camera_px": np.full((4, 2), "one")}, "'camera_px' must be numbers, found <U3"),
    "complex": ({"camera_px": np.zeros((4, 2), complex)}, "'camera_px' must be numbers, found complex128"),
    "truth": ({"camera_px": np.zeros((4, 2), bool)}, "'camera_px' must be numbers, found bool"),
    "fractional faces": ({"face": np.zeros(4)}, "'face' must be whole numbers, found float64"),
    "unknown none": ({"face": np.full(4, -2)}, "'face' must hold -1 for none and labels from 0, found -2"),
    "face of another length": ({"face": np.zeros(3, int)}, r"face must have the shape \(4,\)"),
    "no noise": ({"sigma_px": np.zeros(4)}, "sigma_px must be positive"),
    "empty": ({"camera_px": np.zeros((0, 2)), "projector_px": np.zeros((0, 2))}, "holds no matches"),
    "pickled": ({"camera_px": np.array([[{}, 1]] * 4, dtype=object)}, "holds pickled objects"),
    "fractional planes": ({"plane": np.zeros(4)}, "'plane' must be whole numbers, found float64"),
    "pickled face": ({"face": np.array([None] * 4)}, "holds pickled objects"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_matches_are_refused(tmp_path: Path, name: str) -> None:
    changes, message = WRONG[name]
    arrays = {key: value for key, value in (GOOD | changes).items() if value is not None}
    np.savez(tmp_path / "matches.npz", **arrays)
    with pytest.raises(InputError, match=f"matches.npz: .*{message}"):
        read_matches(tmp_path / "matches.npz")


def test_planes_read_back(tmp_path: Path) -> None:
    path, plane = tmp_path / "matches.npz", np.array([0, -1, 3, 3], np.int32)
    matches = Matches(np.ones((4, 2)), np.zeros((4, 2)))
    write_matches(path, matches, plane)
    np.testing.assert_array_equal(read_planes(path), plane)
    write_matches(path, matches)
    assert read_planes(path) is None
    np.savez(path, **GOOD, plane=plane[:3])
    with pytest.raises(InputError, match=r"matches.npz: plane must have the shape \(4,\), found \(3,\)"):
        read_planes(path)


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "matches.npz"
    np.savez(path, **GOOD)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"expected an .npz file"):
        read_matches(path)


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "matches.npz"
    np.savez(path, **GOOD)
    data = bytearray(path.read_bytes())
    data[200] ^= 0xFF
    path.write_bytes(bytes(data))
    with pytest.raises(InputError, match="damaged"):
        read_matches(path)


def test_an_array_larger_than_any_memory_is_refused(tmp_path: Path) -> None:
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000, 2), }".ljust(117) + b"\n"
    with zipfile.ZipFile(tmp_path / "matches.npz", "w") as archive:
        archive.writestr("camera_px.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    with pytest.raises(InputError, match="damaged"):
        read_matches(tmp_path / "matches.npz")


def test_a_file_that_is_no_archive_is_refused(tmp_path: Path) -> None:
    (tmp_path / "matches.npz").write_bytes(b"\x80\x04K\x01.")
    with pytest.raises(InputError, match=r"expected an .npz file"):
        read_matches(tmp_path / "matches.npz")
    with pytest.raises(InputError, match="no such matches file"):
        read_matches(tmp_path / "other.npz")
