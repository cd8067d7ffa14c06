"""Store the frames of a capture as taken: in memory, or in a memory-mapped file if they are large; or refuse them."""

import os
from math import prod
from tempfile import TemporaryFile
from typing import Any

import cv2
import numpy as np

from calib.numerics import Image
from scanner.errors import InputError
from scanner.io import require_memory, total_bytes

# Share of the machine's memory above which frames are mapped from a file.
_MOST_OF_MEMORY = 0.25
# Peak use, with 16-bit frames and a match at every pixel; with codes only, edges and all pairs are kept as well.
_BYTES_PER_PIXEL, _OF_CODES_ALONE = 70, 136


class Stack:
    """The grey frames (N, H, W) of a capture, in the order in which they were taken.

    A frame is a view that keeps all of them in memory. Raises InputError if there is not enough memory to decode them,
    or not enough room for the file.
    """

    def __init__(self, count: int, first: Image, *, codes_alone: bool) -> None:
        shape = first.shape[0], first.shape[1]
        needed, memory = count * shape[0] * shape[1] * first.itemsize, total_bytes()
        is_mapped = memory is not None and needed > _MOST_OF_MEMORY * memory
        require_decoding_memory(shape, 0 if is_mapped else needed, codes_alone=codes_alone)
        frames = _mapped((count, *shape), first.dtype) if is_mapped else np.empty((count, *shape), first.dtype)
        self._frames: Image = frames
        self._count = 0

    @property
    def frames(self) -> Image:
        """(N, H, W): the frames kept so far."""
        return self._frames[: self._count]

    def keep(self, image: Image) -> Image:
        """Store the next frame, (H, W) grey or (H, W, 3) BGR; return the stored grey copy."""
        kept: Image = self._frames[self._count]
        if image.ndim == 3:
            cv2.cvtColor(image, cv2.COLOR_BGR2GRAY, dst=kept)
        else:
            np.copyto(kept, image)
        self._count += 1
        return kept


def require_decoding_memory(shape: tuple[int, int], kept_bytes: int, *, codes_alone: bool) -> None:
    """Raise InputError if decoding frames (H, W) takes more memory than is free.

    `kept_bytes`: memory of the kept frames.
    """
    needed = kept_bytes + shape[0] * shape[1] * (_OF_CODES_ALONE if codes_alone else _BYTES_PER_PIXEL)
    frames = f"frames of {shape[1]} × {shape[0]} pixels, to be decoded,"
    require_memory(needed, frames, "reduce the frames and the camera's size with them")


def _mapped(shape: tuple[int, int, int], dtype: np.dtype[Any]) -> Image:
    """Return an array of this shape, mapped from a file that is deleted when the array is released."""
    count = prod(shape) * dtype.itemsize
    try:
        with TemporaryFile(prefix="roomscan-") as file:
            # Allocate it now: running out of room while writing to the mapping would kill the program.
            os.posix_fallocate(file.fileno(), 0, count)
            return np.memmap(file, dtype, "r+", shape=shape)
    except OSError as error:
        raise InputError(
            f"{shape[0]} frames of {shape[2]} × {shape[1]} pixels take {count / 1e9:.1f} GB, which is much of the "
            f"memory, and there is no temporary file of that size ({error.strerror}): set TMPDIR to a folder with room"
        ) from error
