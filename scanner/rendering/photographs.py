"""The camera's images for the eye, and pictures as data URIs."""

import base64

import cv2
import numpy as np

from calib.numerics import Image
from scanner.rendering.colours import as_pixels
from scanner.rendering.png import IndexedPicture, Pixels, png_of

LONGEST_SIDE = 1000


def data_uri(picture: Pixels | IndexedPicture, *, jpeg: bool = False) -> str:
    """RGBA (H, W, 4), or one with a palette, as a data URI; with `jpeg`, for photographs, it must be RGB."""
    kind, encoded = ("jpeg", _jpeg_of(picture)) if jpeg else ("png", png_of(picture))
    return f"data:image/{kind};base64,{base64.b64encode(encoded).decode('ascii')}"


def _jpeg_of(picture: Pixels | IndexedPicture) -> bytes:
    assert not isinstance(picture, IndexedPicture)
    bgr = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
    written, encoded = cv2.imencode(".jpeg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 85])
    assert written, "OpenCV encodes JPEG in every build"
    return encoded.tobytes()


def photograph(texture: Image) -> Pixels:
    """The camera's image of the lit scene for the eye: RGB (H, W, 3), reduced, stretched and brightened."""
    small = cv2.resize(texture, reduced_size(texture.shape[1], texture.shape[0]), interpolation=cv2.INTER_AREA)
    levels = np.arange(np.iinfo(texture.dtype).max + 1)
    white = max(1.0, float(np.percentile(small[::2, ::2], 99.5)))
    shown = as_pixels(255 * np.clip(levels / white, 0, 1) ** (1 / 1.8))[small]
    return np.ascontiguousarray(shown[..., ::-1] if shown.ndim == 3 else cv2.cvtColor(shown, cv2.COLOR_GRAY2RGB))


def reduced_size(width: int, height: int, longest_side: int = LONGEST_SIDE) -> tuple[int, int]:
    """(width, height) of an image whose longer side is at most `longest_side`."""
    factor = min(1.0, longest_side / max(width, height))
    return max(1, round(width * factor)), max(1, round(height * factor))
