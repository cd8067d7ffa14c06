"""The camera's images for the eye, and pictures as data URIs."""

import base64

import cv2
import numpy as np

from calib.numerics import Image
from scanner.rendering.colours import IndexedPicture, Pixels, as_pixels, png_of

LONGEST_SIDE = 1000


def png_uri(picture: Pixels | IndexedPicture) -> str:
    """RGBA (H, W, 4), or a picture with a palette, as a data URI."""
    return _data_uri("png", png_of(picture))


def jpeg_uri(pixels: Pixels) -> str:
    """RGB (H, W, 3) as a data URI, for photographs."""
    return _data_uri("jpeg", encode_jpeg(pixels))


def encode_jpeg(pixels: Pixels) -> bytes:
    """RGB (H, W, 3) as the content of a JPEG file."""
    _, encoded = cv2.imencode(".jpeg", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 85])
    return bytes(encoded.tobytes())


def _data_uri(kind: str, encoded: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(encoded).decode('ascii')}"


def photograph(texture: Image, longest_side: int = LONGEST_SIDE) -> Pixels:
    """The camera's image of the lit scene for the eye: RGB (H, W, 3), reduced, stretched and brightened."""
    size = reduced_size(texture.shape[1], texture.shape[0], longest_side)
    small = cv2.resize(texture, size, interpolation=cv2.INTER_AREA)
    levels = np.arange(np.iinfo(texture.dtype).max + 1)
    white = max(1.0, float(np.percentile(small[::2, ::2], 99.5)))
    picture = as_pixels(255 * np.clip(levels / white, 0, 1) ** (1 / 1.8))[small]
    return np.ascontiguousarray(picture[..., ::-1] if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB))


def reduced_size(width: int, height: int, longest_side: int = LONGEST_SIDE) -> tuple[int, int]:
    """(width, height) of an image whose longer side is at most `longest_side`."""
    factor = min(1.0, longest_side / max(width, height))
    return max(1, round(width * factor)), max(1, round(height * factor))
