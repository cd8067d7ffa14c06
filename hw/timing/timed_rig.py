"""The base class of rigs of real devices: measured latency, prefetched frames, and their counts and times.

One picture before and after a capture detects automatic changes of exposure, white balance and focus.
"""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from calib.numerics import Bools, Floats, Image, grey
from hw.ahead import Ahead
from hw.rig import NO_REDUNDANCY, Frames, Redundancy, Rig

_SAME_VIEW = 0.3  # correlation, which blur and dimming hardly change
_CELLS = 32  # across the picture: its edges are resolved, and show blur


@dataclass(frozen=True)
class Appearance:
    """The reference picture as the camera sees it: mean level of each channel (C,) of lit pixels, contrast of its
    edges, and brightness (N,) of the lit pixels.
    """

    levels: np.ndarray
    contrast: float
    lit: Floats


def reference_picture(size: tuple[int, int]) -> Image:
    """A checkerboard of (width, height)."""
    width, height = size
    cell = max(2, width // _CELLS)
    odd = (np.arange(height)[:, None] // cell + np.arange(width)[None, :] // cell) % 2
    return np.where(odd, np.uint8(255), np.uint8(0))


def appearance(image: Image, lit: Bools) -> Appearance:
    """The appearance of a frame (H, W) or (H, W, C); `lit` (H, W)."""
    levels = image[lit].reshape(int(lit.sum()), -1).mean(axis=0, dtype=np.float64)
    light = grey(image)
    both = lit[:, 1:] & lit[:, :-1]
    contrast = float(np.sqrt(np.mean((np.diff(light, axis=1)[both]) ** 2))) if both.any() else 0.0
    return Appearance(levels, contrast / max(float(levels.mean()), 1.0), light[lit])


def is_another_view(first: Appearance, now: Appearance) -> bool:
    """Whether the camera was moved or turned, or sends frames of another shape."""
    return not float(np.corrcoef(first.lit, now.lit)[0, 1]) > _SAME_VIEW


def changes(first: Appearance, last: Appearance) -> Mapping[str, float]:
    """Changes of exposure, white balance and focus in per cent, for the recording's metadata."""
    ratio = last.levels / np.maximum(first.levels, 1.0)
    balance = float(np.ptp(ratio) / ratio.mean())
    return {
        "exposure_percent": round(100 * (float(ratio.mean()) - 1), 1),
        "white_balance_percent": round(100 * balance, 1),
        "focus_percent": round(100 * (last.contrast / max(first.contrast, 1e-9) - 1), 1),
    }


MOST_AHEAD = 16  # prefetched frames; one frame may complete the verification of eight, which then arrive at once


@dataclass
class Tally:
    """Counts of frames and repetitions, and the elapsed time."""

    taken: int = 0
    retriggered: int = 0
    elapsed_s: float = 0.0
    _begun_s: float = 0.0

    def begin(self) -> None:
        """Start counting."""
        self.taken = self.retriggered = 0
        self.elapsed_s, self._begun_s = 0.0, time.monotonic()

    def take(self) -> None:
        """Count a frame."""
        self.taken += 1
        self.elapsed_s = time.monotonic() - self._begun_s

    @property
    def seconds_per_frame(self) -> float:
        """Mean time per frame, including its processing; 0 before the first."""
        return self.elapsed_s / max(1, self.taken)


@dataclass(eq=False, kw_only=True)
class TimedRig(Rig):
    """A rig of real devices with a measured latency. Subclasses handle the kinds of cameras."""

    lost_advice: ClassVar[str]
    """Advice if many frames have to be repeated."""

    latency_s: float
    """Time from the swap of a picture to its light; for a streaming camera, to the first frame that may show it."""

    tally: Tally
    """Counts and times of the last frames."""

    _ahead: Ahead[Frames] | None = field(default=None, init=False)

    @property
    def least_s(self) -> float:
        """The shortest possible time per frame, for the kind of acquisition of the last frames."""
        raise NotImplementedError

    def _acquired(
        self, images: Iterable[Image], exposures_us: Sequence[float], redundancy: Redundancy
    ) -> Iterator[Frames]:
        """The frames of `photograph_together`, each taken on request."""
        raise NotImplementedError

    def _measured(self) -> Mapping[str, object]:
        """Further metadata of synchronisation for the recording."""
        raise NotImplementedError

    def photograph_together(
        self, images: Iterable[Image], exposures_us: Sequence[float] = (), redundancy: Redundancy = NO_REDUNDANCY
    ) -> Iterator[Frames]:
        """A frame of each image by each camera, taken when its light is on the wall. Raises DeviceError.

        If they can be verified, frames are prefetched in a thread. Otherwise each is taken on request.
        """
        frames = self._acquired(images, exposures_us, redundancy)
        self._ahead = Ahead(frames, MOST_AHEAD) if redundancy else None
        return iter(self._ahead or frames)

    def stop(self) -> None:
        """Stop prefetching and wait until no frame is being taken, before the devices are closed."""
        if self._ahead is not None:
            self._ahead.stop()

    @property
    def overhead(self) -> float:
        """Time per frame beyond the shortest possible, relative to that."""
        return self.tally.seconds_per_frame / self.least_s - 1

    def account(self) -> Mapping[str, object]:
        """Latency, repetitions and overhead of the frames so far, for the recording."""
        ahead = self._ahead
        return {
            "synchronisation": {
                "latency_ms": round(1e3 * self.latency_s, 2),
                "retriggered_frames": self.tally.retriggered,
                "ms_per_frame": round(1e3 * self.tally.seconds_per_frame, 2),
                "overhead_percent": round(100 * self.overhead, 1),
                **({} if ahead is None else {"waited_for_computer_s": round(ahead.waited_s, 3)}),
                **self._measured(),
            }
        }
