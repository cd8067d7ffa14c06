"""Images written by rows are read by other libraries, and by rows."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image as Pillow

from scanner.io import PngFile, by_rows, in_rows, row_file, scratch_rows, tiff_rows

SHAPES = [(1, 1), (7, 5), (900, 700), (300, 200, 3), (1, 3, 3), (3, 1, 3)]


def noise(shape: tuple[int, ...]) -> np.ndarray:
    return np.random.default_rng(1).standard_normal(shape).astype(np.float32)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("is_big", [False, True])
def test_opencv_and_pillow_read_a_tiff_of_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shape: tuple[int, ...], is_big: bool
) -> None:
    if is_big:  # as a file of more than 4 GB is
        monkeypatch.setattr(row_file, "_LARGEST_CLASSIC", 0)
    image, path = noise(shape), tmp_path / "image.tiff"
    with tiff_rows(path, shape) as rows:
        rows.write(slice(2, len(image)), image[2:])
        rows.write(slice(0, 2), image[:2])
        assert np.array_equal(rows.read(slice(0, 1)), image[:1])
        assert np.array_equal(rows.read_all(), image)
    assert path.read_bytes()[2] == (43 if is_big else 42)
    read = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert read is not None
    assert np.array_equal(read if image.ndim == 2 else read[..., ::-1], image)
    if image.ndim == 2:  # Pillow has no float colours
        assert np.array_equal(np.asarray(Pillow.open(path)), image)


def test_scratch_leaves_no_file(tmp_path: Path) -> None:
    image = noise((50, 30, 2))
    with scratch_rows(tmp_path, image.shape) as rows:
        rows.write_all(image)
        assert np.array_equal(rows.read(slice(10, 20)), image[10:20])
        with pytest.raises(OSError, match="rows 40 to 60 were not written"):
            rows.read(slice(40, 60))
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("height", "width"), [(1, 1), (3000, 700), (5, 100_000), (1000, 70_000)])
def test_rows_come_in_order_and_once(height: int, width: int) -> None:
    for slices in (list(by_rows((height, width), lambda rows: rows)), in_rows((height, width), lambda rows: rows)):
        assert [number for rows in slices for number in range(rows.start, rows.stop)] == list(range(height))
        assert all((rows.stop - rows.start) * width <= max(1 << 16, width) for rows in slices)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(1, 1), (1201, 997), (640, 611, 3)])
@pytest.mark.parametrize("is_computed", [False, True])
def test_opencv_reads_a_png_of_rows(tmp_path: Path, shape: tuple[int, ...], kind: type, is_computed: bool) -> None:
    image: np.ndarray = np.random.default_rng(5).integers(0, np.iinfo(kind).max + 1, shape).astype(kind)
    with (tmp_path / "image.png").open("wb") as file:
        png = PngFile(file, shape, np.dtype(kind), is_computed=is_computed)
        for rows in by_rows(shape, lambda rows: png.compressed(image[rows], is_last=rows.stop == shape[0])):
            png.append(rows)
    assert np.array_equal(cv2.imread(str(tmp_path / "image.png"), cv2.IMREAD_UNCHANGED), image)
