"""Latency calibration of a streaming camera, with flashes: the time from a swap to the frames that show it.

A picture is stable when two successive frames of a stream show it completely, and nothing else.

screen      ▏white
wall                 ▏white
camera      ▐ old ▌▐ mixed ▌▐ white ▌▐ white ▌
frames          … queue, network …  ▏old  ▏mixed  ▏white  ▏white
"""

import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats, Image
from hw.errors import DeviceError
from hw.timing.devices import FlippingProjector, StreamingCamera
from hw.timing.frame_reader import Arrival
from hw.timing.redundancy import ComplementarySums
from hw.timing.verification import RestingLight

_BANDS = 8  # of rows: a rolling shutter mixes two pictures in some of them
_PARTS = 8  # of each band, side by side; their scatter measures noise, including that of JPEG blocks
_MOST_SHARE = 0.01  # of the previous picture; with a fringe of 16 px in 4 steps a fortieth of a projector pixel
_MOST_CHANGE = 0.01  # of brightness, from frame to frame
_SIGMAS = 4.0
_LEAST_CHANGE = 0.02  # rms, relative to white minus black: below it two pictures look alike


@dataclass(frozen=True)
class StabilityTest:
    """Compares frames by their brightness (N,) at the pixels of `sums`. `order` (B, P, n): indices of these pixels, by
    band of rows and part of the band.
    """

    sums: ComplementarySums
    order: np.ndarray
    most_change: float

    def is_stable(self, before: Floats | None, last: Floats, now: Floats) -> bool:
        """Whether the frames `last` and `now` are alike, without a share of the picture `before` in `last`.

        The share s in `last` = (1 − s) now + s before is found in each band of rows by least squares, regressing
        `now` − `last` on the mean of both minus `before`. Noise of the two frames is uncorrelated between their
        difference and their mean. The scatter between parts of a band gives the uncertainty, because noise of video is
        correlated between pixels (variance of a ratio of cluster sums; Cochran, Sampling Techniques).
        """
        step = now - last
        if abs(float(step.mean())) > self.most_change:
            return False
        if before is None:
            return True
        step, change = step[self.order], ((now + last) / 2 - before)[self.order]
        power = np.mean(change**2, axis=2)
        total = power.mean(axis=1)
        significant = total > self._least_power
        if not significant.any():
            return True
        along = np.mean(step * change, axis=2)[significant]
        share = along.mean(axis=1) / total[significant]
        variance = np.var(along - share[:, None] * power[significant], axis=1, ddof=1).mean()
        by_chance = np.sqrt(variance / _PARTS) / total[significant]
        return bool(np.all(np.abs(share) < _MOST_SHARE + _SIGMAS * by_chance))

    def differs(self, before: Floats, now: Floats) -> bool:
        """Whether two frames show different pictures."""
        return float(np.mean((now - before) ** 2)) > self._least_power

    @property
    def _least_power(self) -> float:
        """The smallest mean square of a difference that exceeds noise."""
        return _LEAST_CHANGE**2 + 4 * self.sums.variance


def stability_test(rest: RestingLight) -> StabilityTest:
    """Made from black and white at rest."""
    rows, columns = rest.sums.pixels
    band = max(_PARTS, len(rows) // _BANDS // _PARTS * _PARTS)
    order = np.argsort(rows, kind="stable")[: len(rows) // band * band].reshape(-1, band)
    across = np.take_along_axis(order, np.argsort(columns[order], axis=1, kind="stable"), axis=1)
    return StabilityTest(rest.sums, across.reshape(len(across), _PARTS, -1), max(_MOST_CHANGE, 2 * rest.tolerance))


log = logging.getLogger(__name__)

_LONGEST_LATENCY_S = 2.0  # streams of telephones lag by half a second or more
_WATCHED_S = 3.0  # automatic exposure adapts to a change from black to white in one or two
_RESTING_FRAMES = 4
_FLASHES = 4
_EDGE = 0.05  # of the light: a frame with this share of the new picture shows it
_SETTLED_FRAMES = 3
_MOST_ADAPTED = 0.15  # at 0.35 the frames of a pattern and of its inverse contradict each other


@dataclass(frozen=True)
class StreamTiming:
    """Latency of frames by their arrival, in seconds, as the range over several flashes."""

    soonest_s: float
    """No frame shows a picture sooner than this after its swap's begin."""
    latest_s: float
    """All frames show nothing else from this long after its end."""
    period_s: float
    """Time between frames."""
    adapted: float
    """Relative change of brightness after white had arrived, the largest of all channels, caused by automatic exposure
    or white balance.
    """


def calibrate_stream(projector: FlippingProjector, camera: StreamingCamera) -> tuple[StreamTiming, RestingLight]:
    """Measure the latency with black and white pictures; takes about seven seconds.

    Raises DeviceError if the camera does not see the projector, adapts its exposure, is frozen, or delivers no frames.
    """
    width, height = projector.size
    pictures = [np.full((height, width), level, np.uint8) for level in (0, 255)]
    projector.show(pictures[0])
    dark = [frame.image for frame in _watched(camera, _LONGEST_LATENCY_S)][-_RESTING_FRAMES:]
    projector.prepare(pictures[1])
    projector.flip()
    series = _series(camera)
    if all(np.array_equal(image, dark[0]) for image in (*dark, *series.last)):
        raise DeviceError(frozen(camera.name))
    if series.adapted > _MOST_ADAPTED:
        raise DeviceError(
            f"camera {camera.name}: its automatic exposure is on: after a change from black to white its picture went "
            f"on to change by {100 * series.adapted:.0f} %, and so it would between patterns. Turn it off in the "
            "camera, its driver or its app, then rerun."
        )
    rest = RestingLight(camera, dark, series.last)
    picture, first, last = 1, [np.inf], [0.0]
    for _ in range(_FLASHES):
        picture = 1 - picture
        projector.prepare(pictures[picture])
        swap = projector.flip()
        seen_s, whole_s = _arrival(camera, rest, picture)
        first.append(seen_s - swap.begun_s)
        last.append(whole_s - swap.done_s)
    timing = StreamTiming(float(min(first)), float(max(last)), camera.reader.period_s, series.adapted)
    log.info("%s", timing)
    return timing, rest


def frozen(name: str) -> str:
    """The message for a camera whose picture does not change."""
    return (
        f"camera {name}: its picture is frozen: frames stay the same, byte by byte, whatever is projected. Restart the "
        "camera or its app, then rerun."
    )


def _watched(camera: StreamingCamera, seconds: float) -> Iterator[Arrival]:
    """All frames that arrive within this time."""
    number, end_s = camera.reader.newest, time.monotonic() + seconds
    while True:
        arrival = camera.reader.following(number)
        number = arrival.number
        yield arrival
        if arrival.came_s > end_s:
            return


@dataclass(frozen=True)
class _Series:
    """Frames after the change from black to white: the `last` ones, and mean levels (T, C) of all."""

    last: list[Image]
    levels: np.ndarray

    @property
    def adapted(self) -> float:
        """Relative change of brightness after the first frame that was about as bright as the last."""
        relative = self.levels / np.maximum(self.levels[-_RESTING_FRAMES:].mean(axis=0), 1.0)
        whole = np.flatnonzero(relative.min(axis=1) > 1 - _EDGE)
        return float(np.abs(relative[whole[0] + 1 :] - 1).max(initial=0.0)) if len(whole) else 0.0


def _series(camera: StreamingCamera) -> _Series:
    last: list[Image] = []
    levels = []
    for arrival in _watched(camera, _WATCHED_S):
        levels.append(np.atleast_1d(arrival.image.mean(axis=(0, 1), dtype=np.float64)))
        last = [*last[1 - _RESTING_FRAMES :], arrival.image]
    return _Series(last, np.stack(levels))


def _arrival(camera: StreamingCamera, rest: RestingLight, target: int) -> tuple[float, float]:
    """Arrival of the first frame that shows a part of a picture, and of the first of several that show nothing else."""
    seen_s: float | None = None
    whole_s: list[float] = []
    for arrival in _watched(camera, _WATCHED_S):
        missing = rest.missing(arrival.image, target)
        if seen_s is None and missing.min() < 1 - _EDGE:
            seen_s = arrival.came_s
        whole_s = [*whole_s, arrival.came_s] if missing.max() < max(_EDGE / 2, rest.tolerance) else []
        if seen_s is not None and len(whole_s) == _SETTLED_FRAMES:
            return seen_s, whole_s[0]
    raise DeviceError(
        f"projector: {_WATCHED_S:.0f} s after a change of the picture, camera {camera.name} still does not see the new "
        "one. Check that it looks at the projector's light and that its stream keeps up, then rerun."
    )
