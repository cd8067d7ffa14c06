"""Frames that show nothing of the picture before: each picture is shown twice, and its second frame is taken."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from typing import TypeVar

from scanner.checking.light import Light, leaves_ghost

Shown = TypeVar("Shown")
Observed = TypeVar("Observed")


def settled(
    show: Callable[[Iterator[Shown]], Iterable[Observed]], pictures: Sequence[Shown], light: Light | None = None
) -> Iterator[Observed]:
    """What `show` sees of each picture when it has settled; one frame of each will do where `light` knows no ghost."""
    times = 2 if light is None or leaves_ghost(light) else 1
    repeated = (picture for picture in pictures for _ in range(times))
    yield from islice(show(repeated), times - 1, None, times)
