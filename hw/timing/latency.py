"""Latency calibration of a projector with flashes: changes between black and white."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import cycle, islice
from math import isfinite
from statistics import median

import numpy as np

from calib.numerics import Floats, Image
from hw.errors import DeviceError, FrameLostError
from hw.rig import Frames
from hw.timing.devices import ATTEMPTS, BufferedProjector, CameraGroup, Swap
from hw.timing.verification import RestingLight

LONGEST_LATENCY_S = 0.3
_RESTING_FRAMES = 3
_FLASHES = 4
_FLASHES_AT_MOST = 50
_LONGEST_FLASH_S = 5.0
_AT_ONCE_S = 0.002  # the trigger comes a moment after the swap
_EDGE = 0.05  # if less than this share of the light is missing, the exposure began after the light had arrived
_REHEARSED = 4


LOST_ADVICE = (
    "Check cable and power; give the camera a network interface of its own, with large packets (packet_size) and a "
    "large receive buffer; then rerun."
)


@dataclass(frozen=True)
class _Arrival:
    """When the light of a flash arrived. `observed`: during an exposure; otherwise some time before the next began.

    `after_s`: measured from the end of its swap, which took `swapping_s`. `soonest_s`: lower limit from the swap's
    begin.
    """

    after_s: float
    observed: bool
    soonest_s: float
    swapping_s: float


@dataclass(frozen=True)
class Latency:
    """The latency from a swap to the light of its picture, in seconds, as the range over several flashes."""

    soonest_s: float
    """Light arrives no sooner than this after the swap's begin."""
    latest_s: float
    """Light arrives no later than this after the swap's end."""
    swapping_s: float
    """Swaps took up to this."""
    cycle_s: float
    """The median time from trigger to frame."""


class LatencyCalibration:
    """Measures with black and white pictures which share of a new picture's light an exposure missed, in each camera.

    Construction records both pictures at rest. `tolerances` (C,): the smallest share in each camera that exceeds noise.
    Raises DeviceError if a camera sees no difference.
    """

    def __init__(self, projector: BufferedProjector, cameras: CameraGroup) -> None:
        self._projector = projector
        self._cameras = cameras
        width, height = projector.size
        self._pictures = tuple(np.full((height, width), level, np.uint8) for level in (0, 255))
        dark, bright = self._resting(0), self._resting(1)
        self._shown = 1
        self._cycles_s: list[float] = []
        self._rests = [
            RestingLight(camera, of_black, of_white)
            for camera, of_black, of_white in zip(
                cameras.cameras, zip(*dark, strict=True), zip(*bright, strict=True), strict=True
            )
        ]
        self.tolerances = np.array([rest.tolerance for rest in self._rests])
        self.sums = tuple(rest.sums for rest in self._rests)

    def latency(self) -> Latency:
        """Measure the latency from several flashes, which all cameras see: the range over all of them.

        If light arrives during an exposure, the missing share gives its time. Exposures in a row after the first flash
        find it approximately; later exposures are placed so that light arrives in their middle, of each camera in turn.
        Raises DeviceError if the light does not arrive, or if frames do not.
        """
        arrivals_by_rest: list[list[_Arrival]] = [[] for _ in self._rests]
        flashes: list[list[_Arrival]] = []
        first_s = 0.0
        for number in range(_FLASHES_AT_MOST):
            waits_s = self._cameras.wait_s if isfinite(self._cameras.wait_s) else 0.0
            # Light may always arrive before a free-running camera begins to expose.
            arrivals = self._flash(first_s, _AT_ONCE_S + waits_s * (number > 2 * _FLASHES))
            if arrivals is None:
                continue
            flashes.append(arrivals)
            for of_rest, arrival in zip(arrivals_by_rest, arrivals, strict=True):
                of_rest += [arrival] if arrival.observed else []
            if min(map(len, arrivals_by_rest)) >= _FLASHES:
                observed = [arrival for of_rest in arrivals_by_rest for arrival in of_rest]
                return Latency(
                    min(arrival.soonest_s for arrival in observed),
                    max(arrival.after_s for arrival in observed),
                    max(arrival.swapping_s for arrival in observed),
                    median(self._cycles_s),
                )
            aimed = number % len(arrivals_by_rest)
            soonest_s = min(flash[aimed].after_s for flash in flashes)  # late exposures only give an upper limit
            # Vary the phase of a free-running camera.
            early_s = self._cameras.cameras[aimed].exposure_s / 2 + waits_s * (number % _FLASHES) / _FLASHES
            first_s = max(0.0, soonest_s - early_s)
        raise DeviceError(
            f"camera {self._cameras.name}: {_FLASHES_AT_MOST} flashes did not tell when the projector's light comes: "
            "frames were lost, or the light does not come evenly. Check the camera's cable and network, turn off the "
            "projector's automatics, then rerun."
        )

    def missing_shares(self, acquire: Callable[[Iterable[Image]], Iterator[Frames]], count: int = _REHEARSED) -> Floats:
        """Take frames of black and white alternately with `acquire`; returns for each camera the largest share (C,) by
        which a band of rows differs from rest."""
        targets = list(islice(cycle((1 - self._shown, self._shown)), count))
        taken = acquire(self._pictures[target] for target in targets)
        shares = [
            [np.abs(rest.missing(frame.image, target)).max() for rest, frame in zip(self._rests, frames, strict=True)]
            for target, frames in zip(targets, taken, strict=True)
        ]
        self._shown = targets[-1]
        largest: Floats = np.max(shares, axis=0)
        return largest

    def _flash(self, first_s: float, at_once_s: float) -> list[_Arrival] | None:
        """Change the picture, and expose from `first_s` after the flip until it is at rest, in each camera.

        None if a lost frame hid the change.
        """
        self._shown = 1 - self._shown
        self._projector.prepare(self._pictures[self._shown])
        swap = self._projector.flip()
        time.sleep(max(0.0, swap.done_s + first_s - time.monotonic()))
        arrivals: dict[int, _Arrival] = {}
        hidden = False
        missing = np.ones(len(self._rests))
        while time.monotonic() - swap.done_s < _LONGEST_FLASH_S:
            begin_s = self._cameras.expose()
            try:
                frames = self._cameras.collect()
                self._cycles_s.append(time.monotonic() - begin_s)
            except FrameLostError:
                hidden = hidden or len(arrivals) < len(self._rests)
                continue
            for number, (rest, frame) in enumerate(zip(self._rests, frames, strict=True)):
                missing[number] = rest.missing(frame.image, self._shown).mean()
                if number not in arrivals and missing[number] < 1 - _EDGE:
                    arrivals[number] = self._arrival(number, float(missing[number]), swap, at_once_s)
            if np.all(missing < _EDGE):
                in_order = [arrivals[number] for number in range(len(missing))]
                return in_order if not hidden or all(arrival.observed for arrival in in_order) else None
        blind = self._cameras.cameras[int(missing.argmax())]
        raise DeviceError(
            f"projector: {_LONGEST_FLASH_S:.0f} s after a change of the picture, camera {blind.name} still does not "
            "see the new one. Check that it looks at the projector's light, and that its frames arrive, then rerun."
        )

    def _arrival(self, number: int, missing: float, swap: Swap, at_once_s: float) -> _Arrival:
        """By the first frame of a camera that shows a new picture, with a share of it missing."""
        camera, after_s = self._cameras.cameras[number], self._cameras.triggered_s[number] - swap.done_s
        swapping_s = swap.done_s - swap.begun_s
        light_s = after_s + camera.late_s + max(0.0, missing) * camera.exposure_s
        if missing > _EDGE:
            return _Arrival(light_s, True, light_s + swapping_s, swapping_s)
        return _Arrival(light_s, after_s < at_once_s, 0.0, swapping_s)

    def _grab(self) -> tuple[Image, ...]:
        for _ in range(ATTEMPTS):
            try:
                return tuple(frame.image for frame in self._cameras.grab())
            except FrameLostError as error:
                lost = error
        raise DeviceError(
            f"camera {lost.camera}: its frames do not arrive ({lost}), {ATTEMPTS} times in a row. {LOST_ADVICE}"
        )

    def _resting(self, which: int) -> list[tuple[Image, ...]]:
        self._projector.show(self._pictures[which])
        time.sleep(LONGEST_LATENCY_S)
        return [self._grab() for _ in range(_RESTING_FRAMES)]
