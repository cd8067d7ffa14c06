"""What rigs of real devices have in common: a measured latency, and what their frames cost."""

import time
from dataclasses import dataclass

from hw.rig import Rig


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


@dataclass(frozen=True)
class TimedRig(Rig):
    """A rig of real devices, of which it was measured how late light follows a picture."""

    @property
    def latency_s(self) -> float:
        """From the swap of a picture to its light; of a camera that streams, to the first frame that may show it."""
        raise NotImplementedError

    @property
    def tally(self) -> Tally:
        """What the last frames cost."""
        raise NotImplementedError

    def stop(self) -> None:
        """Return when no frame is being taken, before the devices are closed."""
        raise NotImplementedError
