"""Frames that wait for others, in memory that is used again and again."""

from collections.abc import Collection, Iterator

import numpy as np

from calib.numerics import Image

_MOST_SPARE = 2


class Waiting:
    """Copies of frames, by number. Fresh memory costs as much as the copy itself: the system clears it first."""

    def __init__(self) -> None:
        self._frames: dict[int, Image] = {}
        self._spare: list[Image] = []

    def keep(self, number: int, frame: Image) -> None:
        """Keep a copy of a frame, all of which are of one size and type."""
        spare = self._spare.pop() if self._spare else np.empty_like(frame)
        np.copyto(spare, frame)
        self._frames[number] = spare

    def take(self, number: int) -> Image | None:
        """The frame that waited under a number, valid until the next one is kept; None if there is none."""
        frame = self._frames.pop(number, None)
        if frame is not None and len(self._spare) < _MOST_SPARE:
            self._spare.append(frame)
        return frame

    def take_all(self, numbers: Collection[int]) -> Iterator[tuple[int, Image]]:
        """Those of the numbers that wait, in the order in which they came, as by `take`."""
        for number in [*self._frames]:
            frame = self.take(number) if number in numbers else None
            if frame is not None:
                yield number, frame

    def let_go(self) -> None:
        """Free the memory: no more frames come."""
        self._frames.clear()
        self._spare.clear()
