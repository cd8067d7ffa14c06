"""Pictures as PNG files: of few colours by a palette, which makes a map a quarter of the work; and RGBA."""

from dataclasses import dataclass
from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Pixels = NDArray[np.uint8]

# Higher levels take several times as long to save a few per cent.
_LEVEL = 1


@dataclass(frozen=True)
class IndexedPicture:
    """`index` (H, W) into `palette` (n, 4), RGBA of at most 256 colours."""

    index: Pixels
    palette: Pixels

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows and columns."""
        return self.index.shape


def png_of(picture: IndexedPicture | Pixels) -> bytes:
    """The file of a picture with a palette, or of RGBA (H, W, 4)."""
    if isinstance(picture, IndexedPicture):
        image = Image.fromarray(picture.index)
        image.putpalette(picture.palette[:, :3].tobytes(), "RGB")
        opacity = picture.palette[:, 3].tobytes()
    else:
        image, opacity = Image.fromarray(picture), None
    file = BytesIO()
    image.save(file, "PNG", compress_level=_LEVEL, **({} if opacity is None else {"transparency": opacity}))
    return file.getvalue()
