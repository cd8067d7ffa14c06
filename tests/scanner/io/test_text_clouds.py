"""Clouds as text are read however their numbers are apart, or refused by name."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib.numerics import Floats
from scanner.errors import InputError
from scanner.io import read_surface

COUNT = 300
POINTS = np.random.default_rng(3).uniform(-100, 100, (COUNT, 3)).round(4)
COLOURS = np.random.default_rng(4).integers(0, 256, (COUNT, 3))


def lines(values: Floats, separator: str = " ", end: str = "\n") -> str:
    return "".join(separator.join(f"{value:.8g}" for value in row) + end for row in values)


WITH_COLOURS = np.hstack([POINTS, COLOURS])
WRITTEN: dict[str, tuple[str, str]] = {
    "blanks": ("a.xyz", lines(POINTS)),
    "indented": ("a.xyz", "  " + lines(POINTS, "   ", "  \n  ")),
    "tabs": ("a.xyz", lines(POINTS, "\t")),
    "commas": ("a.xyz", lines(POINTS, ",")),
    "commas and blanks": ("a.xyz", lines(POINTS, ", ")),
    "semicolons": ("a.xyz", lines(POINTS, ";")),
    "decimal commas": ("a.xyz", lines(POINTS).replace(".", ",")),
    "decimal commas and semicolons": ("a.xyz", lines(POINTS, ";").replace(".", ",")),
    "Windows": ("a.xyz", lines(POINTS, end="\r\n")),
    "old Macintosh": ("a.xyz", lines(POINTS, end="\r")),
    "byte order mark": ("a.xyz", "\ufeff" + lines(POINTS)),
    "no end": ("a.xyz", lines(POINTS).rstrip()),
    "header": ("a.xyz", "X Y Z\n" + lines(POINTS)),
    "remarks": ("a.xyz", "# made by hand\n//X,Y,Z\n" + lines(POINTS, ",")),
    "count": ("a.xyz", f"{COUNT}\n" + lines(POINTS)),
    "intensity": ("a.xyz", lines(WITH_COLOURS[:, :4])),
    "colours": ("a.xyzrgb", lines(WITH_COLOURS)),
    "numbered": ("a.xyz", lines(np.hstack([np.arange(COUNT)[:, None], POINTS]))),
    "other order": ("a.xyz", "R;G;B;Z;Y;X\n" + lines(WITH_COLOURS[:, [3, 4, 5, 2, 1, 0]], ";")),
    "words behind": ("a.xyz", lines(POINTS, end=" wall\n")),
    "PTS": ("a.pts", f"{COUNT}\n" + lines(WITH_COLOURS)),
    "PTS of Windows": ("a.pts", f"{COUNT}\r\n" + lines(WITH_COLOURS, end="\r\n")),
    "PTS without a count": ("a.pts", lines(WITH_COLOURS)),
    "PLY": (
        "a.ply",
        f"ply\nformat ascii 1.0\nelement vertex {COUNT}\n"
        + "".join(f"property float {name}\n" for name in ("red", "green", "blue", "z", "y", "x"))
        + "end_header\n"
        + lines(WITH_COLOURS[:, [3, 4, 5, 2, 1, 0]]),
    ),
    "PCD": (
        "a.pcd",
        "VERSION 0.7\nFIELDS rgb x y z\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 3 1 1 1\n"
        f"WIDTH {COUNT}\nHEIGHT 1\nPOINTS {COUNT}\nDATA ascii\n" + lines(WITH_COLOURS[:, [3, 4, 5, 0, 1, 2]]),
    ),
}


@pytest.mark.parametrize("kind", WRITTEN)
def test_points_are_read_however_they_are_written(kind: str, tmp_path: Path) -> None:
    name, text = WRITTEN[kind]
    (tmp_path / name).write_bytes(text.encode())
    read = read_surface(tmp_path / name)
    assert np.allclose(read.points, POINTS, atol=1e-4)
    assert (read.dropped, read.thinned_from, read.normals) == (0, None, None)


def test_lines_without_numbers_are_left_out_and_counted(tmp_path: Path) -> None:
    rows = lines(POINTS).splitlines()
    rows[10:13], rows[20] = ["a wall begins", "1.0 2.0", "1 2 x"], "# a remark"
    (tmp_path / "a.xyz").write_text("\n".join(rows))
    read = read_surface(tmp_path / "a.xyz")
    assert np.allclose(read.points, np.delete(POINTS, [10, 11, 12, 20], axis=0), atol=1e-4)
    assert read.dropped == 3


def test_normals_are_read(tmp_path: Path) -> None:
    normals = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)
    (tmp_path / "a.xyzn").write_text(lines(np.hstack([POINTS, 3 * normals])))
    (tmp_path / "a.xyz").write_text("x y z nx ny nz\n" + lines(np.hstack([POINTS, normals])))
    for name in ("a.xyzn", "a.xyz"):
        read = read_surface(tmp_path / name)
        assert read.normals is not None
        assert np.allclose(read.normals, normals, atol=1e-6)


def test_lines_of_a_large_file_are_spread_evenly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scanner.io.stored_points.MOST_POINTS", 70)
    monkeypatch.setattr("scanner.io.surface_file.MOST_POINTS", 70)
    monkeypatch.setattr("scanner.io.text_rows._PIECE", 999)
    (tmp_path / "a.xyz").write_text(lines(POINTS))
    read = read_surface(tmp_path / "a.xyz")
    assert np.allclose(read.points, POINTS[::5], atol=1e-4)
    assert read.thinned_from == COUNT


def cut(kind: str) -> bytes:
    return WRITTEN[kind][1].encode()[:-3000]


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.xyz", lambda: lines(POINTS[:, :2]).encode(), "expected lines with three numbers, x y z, or more, found '"),
        ("a.xyz", lambda: lines(POINTS).encode("utf-16"), "UTF-16"),
        ("a.xyz", lambda: b"Dear Sir,\nthank you for 3 of them.\n" * 9, "found 'Dear Sir,'"),
        ("a.xyz", lambda: (lines(POINTS[:40]) + "nothing more\n" * 90).encode(), "found 'nothing more'"),
        ("a.pts", lambda: cut("PTS"), "is truncated: its header promises 300 points, and"),
        ("a.ply", lambda: cut("PLY"), "is truncated: its header promises 300 points, and"),
        ("a.pcd", lambda: cut("PCD"), "is truncated: its header promises 300 points, and"),
        ("a.pcd", lambda: b"x y z\n", "expected a cloud as PCD"),
    ],
)
def test_other_text_is_refused(name: str, content: Callable[[], bytes], told: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content())
    with pytest.raises(InputError, match=f"{name}: .*{told}"):
        read_surface(tmp_path / name)
