"""One round of frames → a cloud."""

from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Calibration, depths_on_stripes
from calib.numerics import Floats, Image, in_slices
from hw.rig import Frame
from scanner.decoding import MaskReason
from scanner.live.first_look import FirstLook
from scanner.live.sequence import LiveSequence
from scanner.live.unwrapping import Map, Reasons, leave_out_isolated, unwrap

_ROWS = 64
_POINTS = 1 << 14
_STEP = 4.0  # factor on the projector pixels between neighbours on a surface seen face on
# Share of inconsistent lit pixels: beyond it, a frame is wrong, or everything moves.
_MOST_CONTRADICTING = 0.4
# Factor by which the change of one frame exceeds that of any other; noise and motion affect all.
_MOST_FOREIGN = 1.3
_BY_CHANCE = 4.0  # standard deviations of a mean of squares
_SAMPLED, _CLIPPED = 5, 9.0  # every fifth row and column; squared differences are clipped here


@dataclass(frozen=True, eq=False)
class Round:
    """The `frames` of a sequence, `grey` (6, H, W), and how many rounds were begun before; lost ones count. `came_s`:
    when the last frame did, by `time.monotonic`.
    """

    number: int
    frames: tuple[Frame, ...]
    grey: Image
    came_s: float


@dataclass(frozen=True, eq=False)
class LiveCloud:
    """The result of a round."""

    taken: Round
    coordinate: Map
    """Along the sequence's axis, NaN for none, (H, W)."""
    variance: Map
    """Of the coordinate, (H, W)."""
    reason: Reasons
    """A `MaskReason` for each pixel, (H, W)."""
    moving: Reasons
    """1 where the brightness has changed since the last round, (H, W)."""
    foreign: float
    """By how much more, beyond chance, one frame has changed than any other of the six."""
    pixel: NDArray[np.int64]
    """Index of each point in (H, W), (N,)."""
    points: NDArray[np.float32]
    """In the camera's frame and the calibration's unit, (N, 3)."""
    sigma: NDArray[np.float32]
    """Standard deviation along each point's ray, from noise and motion, (N,)."""

    @cached_property
    def picture(self) -> Image:
        """Evenly lit, (H, W): the mean of all frames."""
        mean = self.taken.grey.mean(axis=0, dtype=np.float32)
        return cast(Image, np.rint(mean).astype(self.taken.grey.dtype))

    @cached_property
    def lit(self) -> int:
        """How many pixels see the patterns."""
        return int(np.count_nonzero(self.reason != MaskReason.DARK))

    def share(self, *reasons: MaskReason) -> float:
        """Of the lit pixels, those that were left out for one of these."""
        return float(np.count_nonzero(np.isin(self.reason, reasons))) / max(1, self.lit)

    @cached_property
    def moving_share(self) -> float:
        """Of the lit pixels, those that move, be they left out or not."""
        return float(np.count_nonzero(self.moving)) / max(1, self.lit)

    @cached_property
    def contradicts_itself(self) -> bool:
        """Whether there is no cloud in this: a frame was of another picture, or everything moved."""
        return self.foreign > _MOST_FOREIGN or self.share(MaskReason.INCONSISTENT) > _MOST_CONTRADICTING


class LiveDecoder:
    """The decoder of one rig and one sequence. It has no state: the reference of a round is an argument."""

    def __init__(self, sequence: LiveSequence, look: FirstLook, calibration: Calibration) -> None:
        self.sequence, self._look, self._calibration = sequence, look, calibration
        camera = calibration.camera
        self._ideal = np.ascontiguousarray(camera.ideal(camera.size.pixels.reshape(-1, 2)).T)
        self._step_px = _STEP * calibration.projector.focal_px[0] / camera.focal_px[0]

    def cloud(self, taken: Round, before: LiveCloud | None = None) -> LiveCloud:
        """Of a round, compared with the cloud of an earlier one."""
        shape = taken.grey.shape[1:]
        coordinate, variance = np.empty(shape, np.float32), np.empty(shape, np.float32)
        reason, moving = np.empty(shape, np.uint8), np.empty(shape, np.uint8)
        apart = 0 if before is None else taken.number - before.taken.number
        earlier = (taken.grey, coordinate) if before is None else (before.taken.grey, before.coordinate)
        periods = self.sequence.long_px, self.sequence.short_px
        length = float(self._calibration.projector.size[self.sequence.number])

        def unwrap_rows(rows: slice) -> None:
            unwrap(
                taken.grey[:, rows],
                earlier[0][:, rows],
                earlier[1][rows],
                float(apart),
                self.sequence.middle[rows],
                periods,
                length,
                self._look.noise,
                self._look.saturated,
                coordinate[rows],
                variance[rows],
                reason[rows],
                moving[rows],
            )

        def isolated_rows(rows: slice) -> None:
            leave_out_isolated(coordinate, variance, self._step_px, reason, rows.start, rows.stop)

        in_slices(shape[0], _ROWS, unwrap_rows)
        in_slices(shape[0], _ROWS, isolated_rows)
        foreign = 1.0 if before is None else self._foreign(taken.grey, before.taken.grey, reason)
        return self._triangulated(taken, coordinate, variance, reason, moving, foreign)

    def _foreign(self, frames: Image, before: Image, reason: Reasons) -> float:
        """As of `LiveCloud`. That a frame is brighter as a whole is flicker."""
        at_black, gain = self._look.noise
        lit = ~np.isin(reason[::_SAMPLED, ::_SAMPLED], (MaskReason.DARK, MaskReason.SATURATED))
        if not lit.any():
            return 1.0
        now, then = (images[:, ::_SAMPLED, ::_SAMPLED][:, lit].astype(np.float32) for images in (frames, before))
        now *= np.sum(now * then, axis=1, keepdims=True) / np.maximum(np.sum(now * now, axis=1, keepdims=True), 1.0)
        changes = (now - then) ** 2 / (2 * (at_black + gain * then))
        second, most = np.sort(np.minimum(changes, _CLIPPED).mean(axis=1))[-2:]
        return float(most / max(second, 1e-6) - _BY_CHANCE * np.sqrt(2 / np.count_nonzero(lit)))

    def _triangulated(
        self, taken: Round, coordinate: Map, variance: Map, reason: Reasons, moving: Reasons, foreign: float
    ) -> LiveCloud:
        pixel = np.flatnonzero(reason == MaskReason.KEPT)
        points, sigma = np.empty((len(pixel), 3), np.float32), np.empty(len(pixel), np.float32)
        there = np.empty(len(pixel), np.bool_)

        def fill(at: slice) -> None:
            chosen = pixel[at]
            ideal: Floats = self._ideal[:, chosen]
            known = coordinate.ravel()[chosen].astype(np.float64)
            depth, per_px = depths_on_stripes(ideal, known, self.sequence.number, self._calibration)
            points[at, 0], points[at, 1], points[at, 2] = ideal[0] * depth, ideal[1] * depth, depth
            along = np.sqrt(1 + ideal[0] ** 2 + ideal[1] ** 2)
            sigma[at] = np.abs(per_px) * along * np.sqrt(variance.ravel()[chosen])
            there[at] = np.isfinite(depth) & np.isfinite(sigma[at])

        in_slices(len(pixel), _POINTS, fill)
        if not there.all():
            reason.ravel()[pixel[~there]] = MaskReason.OUTSIDE
            pixel, points, sigma = pixel[there], points[there], sigma[there]
        np.copyto(coordinate, np.nan, where=reason != MaskReason.KEPT)
        return LiveCloud(taken, coordinate, variance, reason, moving, foreign, pixel, points, sigma)
