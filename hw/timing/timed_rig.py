"""What rigs of real devices have in common: a measured latency, frames that are taken ahead, and what these cost."""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from calib.numerics import Image
from hw.ahead import Ahead
from hw.rig import Frame, Rig

MOST_AHEAD = 16  # frames that wait for whoever records and decodes them: eight may be proven by one, and come at once


@dataclass
class Tally:
    """How many frames there have been, how long that took, and how many were taken again."""

    taken: int = 0
    retriggered: int = 0
    elapsed_s: float = 0.0
    _begun_s: float = 0.0

    def begin(self) -> None:
        """Count from now on."""
        self.taken = self.retriggered = 0
        self.elapsed_s, self._begun_s = 0.0, time.monotonic()

    def take(self) -> None:
        """One more."""
        self.taken += 1
        self.elapsed_s = time.monotonic() - self._begun_s

    @property
    def seconds_per_frame(self) -> float:
        """Time from one frame to the next, whatever was done with it included; 0 before the first."""
        return self.elapsed_s / max(1, self.taken)


@dataclass
class _Lately:
    """How the last frames were taken."""

    ahead: Ahead[Frame] | None = None


@dataclass(frozen=True, kw_only=True)
class TimedRig(Rig):
    """A rig of real devices, of which it was measured how late light follows a picture. What kind of camera it has,
    subclasses know.
    """

    lost_advice: ClassVar[str]
    """What to do where many frames have to be taken again."""

    _lately: _Lately = field(default_factory=_Lately)

    @property
    def latency_s(self) -> float:
        """From the swap of a picture to its light; of a camera that streams, to the first frame that may show it."""
        raise NotImplementedError

    @property
    def tally(self) -> Tally:
        """What the last frames cost."""
        raise NotImplementedError

    @property
    def least_s(self) -> float:
        """What one of the last frames had to cost, the way in which they were taken."""
        raise NotImplementedError

    def _acquired(
        self,
        images: Iterable[Image],
        exposures_us: Sequence[float],
        level: Sequence[Sequence[int]],
        unpaired: Sequence[Sequence[int]],
    ) -> Iterator[Frame]:
        """The frames of `photograph`, each taken when it is asked for."""
        raise NotImplementedError

    def _measured(self) -> Mapping[str, object]:
        """What is worth recording of synchronisation beside what all such rigs record."""
        raise NotImplementedError

    def photograph(
        self,
        images: Iterable[Image],
        exposures_us: Sequence[float] = (),
        level: Sequence[Sequence[int]] = (),
        unpaired: Sequence[Sequence[int]] = (),
    ) -> Iterator[Frame]:
        """A frame of each image, taken when its light is on the wall. Raises DeviceError.

        Images of which some prove each other are a capture: its frames are taken some ahead of who asks for them. All
        others are taken when they are asked for.
        """
        frames = self._acquired(images, exposures_us, level, unpaired)
        self._lately.ahead = Ahead(frames, MOST_AHEAD) if level or unpaired else None
        return iter(self._lately.ahead or frames)

    def stop(self) -> None:
        """Return when no frame is being taken, before the devices are closed."""
        if self._lately.ahead is not None:
            self._lately.ahead.stop()

    @property
    def overhead(self) -> float:
        """Time per frame beyond the least, relative to that."""
        return self.tally.seconds_per_frame / self.least_s - 1

    def account(self) -> Mapping[str, object]:
        """What synchronisation measured, and what the frames so far cost over what was unavoidable."""
        ahead = self._lately.ahead
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
