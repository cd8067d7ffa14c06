"""The pictures of the first printed page: small versions of those of the page."""

import base64
from dataclasses import replace

import cv2
import numpy as np

from scanner.rendering import jpeg_uri
from scanner.reporting.sections import Picture

_SIDE = 640


def on_paper(picture: Picture) -> Picture:
    """The picture on white, as JPEG and reduced: it is on the page a second time."""
    encoded = np.frombuffer(base64.b64decode(picture.uri.partition(",")[2]), np.uint8)
    pixels = np.asarray(cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED))
    if pixels.ndim == 3 and pixels.shape[2] == 4:
        share = pixels[..., 3:].astype(np.float32) / 255
        pixels = np.rint(share * pixels[..., :3] + 255 * (1 - share)).astype(np.uint8)
    factor = min(1.0, _SIDE / max(pixels.shape[:2]))
    small = cv2.resize(pixels, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    rgb = np.asarray(cv2.cvtColor(small, cv2.COLOR_BGR2RGB if small.ndim == 3 else cv2.COLOR_GRAY2RGB), np.uint8)
    return replace(picture, uri=jpeg_uri(rgb), width=rgb.shape[1], height=rgb.shape[0])
