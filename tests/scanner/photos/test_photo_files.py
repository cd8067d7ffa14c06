"""Reading photos: EXIF orientation and focal length, and unusable files."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageOps

from scanner.errors import InputError
from scanner.photos.photo import read_photos

ORIENTATION, EXIF_IFD, FOCAL_35MM = 0x0112, 0x8769, 0xA405


def write(path: Path, pixels: np.ndarray, orientation: int = 1, focal_mm: int | None = None) -> Path:
    image = Image.fromarray(pixels)
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    if focal_mm is not None:
        exif.get_ifd(EXIF_IFD)[FOCAL_35MM] = focal_mm
    image.save(path, exif=exif, quality=100, subsampling=0)
    return path


@pytest.fixture
def pixels() -> np.ndarray:
    """Increasing brightness, different along both axes, which identifies every orientation in a JPEG."""
    rows, columns = np.mgrid[:48, :64]
    return np.stack([4 * rows, 3 * columns, 2 * rows + columns], axis=-1).astype(np.uint8)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
def test_photos_are_rotated_by_their_exif_orientation(
    tmp_path: Path, pixels: np.ndarray, orientation: int, suffix: str
) -> None:
    paths = [write(tmp_path / f"{name}.{suffix}", pixels, orientation) for name in "ab"]
    first, _ = read_photos(paths)
    with Image.open(paths[0]) as image:
        expected = np.asarray(ImageOps.exif_transpose(image).convert("RGB"), int)[..., ::-1]
    assert first.size == (expected.shape[1], expected.shape[0])
    assert np.abs(first.pixels.astype(int) - expected).max() <= 4
    assert first.pixels.flags.c_contiguous


def test_a_camera_that_was_turned_between_photos_has_one_sensor(tmp_path: Path, pixels: np.ndarray) -> None:
    paths = [write(tmp_path / "a.png", pixels, 6), write(tmp_path / "b.png", pixels, 1)]
    first, second = read_photos(paths)
    assert first.size == second.size == (48, 64)
    assert np.array_equal(first.pixels, second.pixels)


def test_the_focal_length_is_read_in_pixels(tmp_path: Path, pixels: np.ndarray) -> None:
    paths = [write(tmp_path / "a.jpg", pixels, 1, 26), write(tmp_path / "b.jpg", pixels)]
    first, second = read_photos(paths)
    assert first.focal_px == pytest.approx(26 / 43.2666 * 80, rel=1e-4)
    assert second.focal_px is None


def test_sixteen_bits_are_reduced_to_eight(tmp_path: Path) -> None:
    grey = np.linspace(0, 65535, 64 * 48).reshape(48, 64).astype(np.uint16)
    for name in "ab":
        Image.fromarray(grey).save(tmp_path / f"{name}.png")
    first, _ = read_photos([tmp_path / "a.png", tmp_path / "b.png"])
    assert first.pixels.dtype == np.uint8
    assert first.pixels.max() == 255


def test_photos_of_different_sizes_are_refused(tmp_path: Path, pixels: np.ndarray) -> None:
    paths = [write(tmp_path / "a.png", pixels), write(tmp_path / "b.png", pixels[:40])]
    with pytest.raises(InputError, match=r"one size, found a\.png 64 × 48, b\.png 64 × 40"):
        read_photos(paths)


def test_a_photo_given_twice_is_refused(tmp_path: Path, pixels: np.ndarray) -> None:
    path = write(tmp_path / "a.png", pixels)
    with pytest.raises(InputError, match="given twice"):
        read_photos([path, path])


@pytest.mark.parametrize("content", [b"", b"no image", b"\xff\xd8\xff\xe0 broken off"])
def test_a_file_without_an_image_is_refused(tmp_path: Path, pixels: np.ndarray, content: bytes) -> None:
    good = write(tmp_path / "a.jpg", pixels)
    bad = tmp_path / "b.jpg"
    bad.write_bytes(content)
    with pytest.raises(InputError, match=r"b\.jpg"):
        read_photos([good, bad])
