"""Access to the pictures of an iterator by number."""

from collections.abc import Iterator

from calib.numerics import Image


class NumberedPictures:
    """Reads pictures, numbered from 0, on demand, and keeps them until `forget`."""

    def __init__(self, images: Iterator[Image]) -> None:
        self._images = images
        self._known: dict[int, Image] = {}
        self._count = 0
        self._ended = False

    def __getitem__(self, number: int) -> Image:
        return self._known[number]

    def has(self, number: int) -> bool:
        """Whether there is a picture with this number."""
        while self._count <= number and not self._ended:
            image = next(self._images, None)
            if image is None:
                self._ended = True
            else:
                self._known[self._count] = image
                self._count += 1
        return number < self._count

    def forget(self, before: int) -> None:
        """Drop the pictures with smaller numbers."""
        for number in [known for known in self._known if known < before]:
            del self._known[number]
