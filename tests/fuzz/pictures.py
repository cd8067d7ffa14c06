"""Readers of images: all formats, masks, and photos with metadata."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image, TiffImagePlugin

from tests.fuzz.guarded import Run, guarded
from tests.fuzz.mutations import Random, of_bytes, of_header

FORMATS = (".png", ".jpg", ".tif", ".bmp", ".webp", ".jp2", ".gif", ".pgm", ".ppm", ".ras", ".avif")


def _picture(rng: Random, channels: int, dtype: Any) -> Any:
    rough = rng.integers(0, 256, (70, 90, channels)).astype(np.uint8)
    smooth = cv2.GaussianBlur(rough, (0, 0), 2).reshape(70, 90, channels)
    return (smooth.astype(dtype) * (257 if dtype == np.uint16 else 1)).squeeze()


def _encoded(suffix: str) -> list[bytes]:
    rng = np.random.default_rng(0)
    found = []
    for channels in (1, 3, 4):
        for dtype in (np.uint8, np.uint16):
            try:
                done, data = cv2.imencode(suffix, _picture(rng, channels, dtype))
            except cv2.error:
                continue
            found += [data.tobytes()] if done else []
    return found + [encode(_picture(rng, 3, np.uint8)) for encode in _PILLOW.get(suffix, ())]


def _by_pillow(kind: str, mode: str, **options: Any) -> Callable[[Any], bytes]:
    def encode(pixels: Any) -> bytes:
        stream = io.BytesIO()
        Image.fromarray(pixels).convert(mode).save(stream, kind, **options)
        return stream.getvalue()

    return encode


_PILLOW: dict[str, tuple[Callable[[Any], bytes], ...]] = {
    ".png": (_by_pillow("PNG", "P"), _by_pillow("PNG", "1"), _by_pillow("PNG", "LA")),
    ".jpg": (_by_pillow("JPEG", "RGB", progressive=True), _by_pillow("JPEG", "CMYK")),
    ".tif": tuple(
        _by_pillow("TIFF", mode, compression=compression)
        for mode, compression in (("RGB", None), ("RGB", "tiff_adobe_deflate"), ("L", "packbits"), ("1", "group4"))
    ),
    ".webp": (_by_pillow("WEBP", "RGB", lossless=True),),
    ".gif": (_by_pillow("GIF", "P"),),
    ".ppm": (_by_pillow("PPM", "RGB"), _by_pillow("PPM", "1")),
}


def image(suffix: str) -> Callable[[Path], Run]:
    """Images of one format."""

    def target(folder: Path) -> Run:
        from scanner.io import read_image

        seeds = _encoded(suffix)
        assert seeds, f"nothing here writes {suffix}"
        path = folder / f"frame{suffix}"

        def read(rng: Random) -> None:
            path.write_bytes(of_header(seeds[int(rng.integers(len(seeds)))], rng))
            read_image(path)

        return guarded(read)

    return target


def masks(folder: Path) -> Run:
    """Three masks, one of them changed."""
    from calib.geometry import Size
    from scanner.reconstruction import read_masks

    whole = []
    for index in range(3):
        pixels = np.zeros((31, 45), np.uint8)
        pixels[:, 15 * index : 15 * index + 15] = 255
        whole.append(cv2.imencode(".png", pixels)[1].tobytes())
        (folder / f"{index}.png").write_bytes(whole[-1])

    def read(rng: Random) -> None:
        (folder / "1.png").write_bytes(of_header(whole[1], rng))
        read_masks(folder, Size(45, 31))

    return guarded(read)


def photos(folder: Path) -> Run:
    """Photos with EXIF data."""
    from scanner.photos import read_photos

    exif = Image.Exif()
    exif[0x0112] = 6
    exif[0x010F] = "maker"
    exif.get_ifd(0x8769).update(
        {0xA405: 28, 0x9003: "2024:01:01 00:00:00", 0x920A: TiffImagePlugin.IFDRational(28, 10)}
    )
    stream = io.BytesIO()
    Image.fromarray(_picture(np.random.default_rng(0), 3, np.uint8)).save(stream, "JPEG", exif=exif)
    seed = stream.getvalue()
    (folder / "a.jpg").write_bytes(seed)

    def read(rng: Random) -> None:
        cut = 250 if rng.random() < 0.8 else len(seed)
        (folder / "b.jpg").write_bytes(of_bytes(seed[:cut], rng) + seed[cut:])
        read_photos([folder / "a.jpg", folder / "b.jpg"])

    return guarded(read)
