"""How far the capture of each pair is, and how much of its picture each camera sees in each projector's light."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from math import prod
from types import TracebackType
from typing import TypeVar

from hw.rig import Frame
from scanner.networks.captures import Pair
from scanner.quantities import percent
from scanner.results import Decoded
from scanner.ui import Progress

T = TypeVar("T")


@dataclass(frozen=True)
class PairProgress:
    """A camera in a projector's light, of which `done` of `total` frames are taken.

    `share`: of the camera's pixels, those that are matched; None until the capture is decoded. `failure`: why there is
    no capture, '' if there may be one.
    """

    camera: str
    projector: str
    total: int = 0
    done: int = 0
    share: float | None = None
    failure: str = ""

    @classmethod
    def of(cls, pair: Pair, capture: Decoded) -> "PairProgress":
        """What a decoded capture shows."""
        count = len(capture.metadata.patterns)
        return cls(*pair, count, count, len(capture.matches) / prod(capture.metadata.camera_size))

    @property
    def name(self) -> str:
        """Which pair it is."""
        return in_light(self.camera, self.projector)

    @property
    def text(self) -> str:
        """Its state in words."""
        if self.failure:
            return f"failed: {self.failure}"
        if self.share is not None:
            return f"{percent(self.share)} of its picture"
        return f"{self.done} of {self.total} frames" if self.done else "waiting"


def in_light(camera: str, projector: str) -> str:
    """A pair in words."""
    return f"{camera} in the light of {projector}"


OnSight = Callable[[PairProgress, Frame | None], object]  # with the frame that has just been taken, if one has


def nobody(_: PairProgress, __: Frame | None) -> None:
    """Does nothing."""


class Watched(AbstractContextManager["Watched"]):
    """The captures of pairs that are taken together: `scanner.ui.Progress` that passes on to another, and tells
    `on_sight` of each frame.

    It tells also of an error that ends its `with` block, to which it adds whose captures these were.
    """

    def __init__(self, pairs: Sequence[Pair], progress: Progress, on_sight: OnSight) -> None:
        self._sights = {pair: PairProgress(*pair) for pair in pairs}
        self._progress, self._on_sight = progress, on_sight

    def track(self, items: Iterable[T], total: int, _: str) -> Iterator[T]:
        """Pass `items` on, and tell how many went by, and of which pairs in place of what is done with them."""
        for done, item in enumerate(self._progress.track(items, total, self._names), start=1):
            for sight, frame in zip([*self._sights.values()], frames_in(item), strict=False):
                self._tell(replace(sight, done=done, total=total), frame)
            yield item

    def step(self, what: str) -> AbstractContextManager[None]:
        """Tell what is being done."""
        return self._progress.step(what)

    def decoded(self, pair: Pair, capture: Decoded) -> None:
        """All of it is known."""
        self._tell(PairProgress.of(pair, capture))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is not None:
            error.add_note(f"This was {self._names}.")
            for sight in [*self._sights.values()]:
                if sight.share is None:
                    self._tell(replace(sight, failure=str(error) or type(error).__name__))

    @property
    def _names(self) -> str:
        cameras, projectors = (" and ".join(dict.fromkeys(names)) for names in zip(*self._sights, strict=True))
        return in_light(cameras, projectors)

    def _tell(self, sight: PairProgress, frame: Frame | None = None) -> None:
        self._sights[sight.camera, sight.projector] = sight
        self._on_sight(sight, frame)


def frames_in(item: object) -> tuple[Frame, ...]:
    """The frames of (pattern, frame), as captures go by, or of one such for each camera; none of anything else."""
    if isinstance(item, tuple):
        return tuple(frame for part in item for frame in frames_in(part))
    return (item,) if isinstance(item, Frame) else ()
