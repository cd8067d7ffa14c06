"""The share of the later of two pictures in each row of the frames around a change."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.numerics import Bools, Floats, Ints
from scanner.recordings.clocks import Clocks
from scanner.recordings.programme import Programme
from scanner.recordings.samples import Light, VideoSamples

_AROUND = 0.6  # slots before and after a change
_FRAMES_PER_CHANGE = 10  # more frames, of a fast camera, add no information
_MIDDLE = 0.15  # slots; frames this close to a slot's middle show its picture
ROBUST = 0.05  # limit of a share; larger deviations are no noise
_CLUSTERS = 32  # of times after a change
_LEAST_ENERGY = 1e-3  # relative to the usual; less gives no information


@dataclass(frozen=True)
class Shares:
    """Shares of the M frames near changes, in R rows."""

    change: Ints  # (M,): number of the change, through all loops
    time_s: Floats  # (M,) of the frame
    row: Floats  # (R,), counted from the middle row
    share: Floats  # (M, R, 2): of the later picture, from pixels that brighten and from those that darken
    weight: Floats  # (M, R, 2)
    changes: int  # number of changes, of all loops

    @cached_property
    def weight_of_changes(self) -> Floats:
        """(changes,): sum of the weights of each change."""
        return self.summed(self.weight)

    def summed(self, values: Floats) -> Floats:
        """Sum of the `values` (M, R, 2) of each change, (changes,)."""
        total = values.reshape(len(self.change), -1).sum(axis=1)
        return np.bincount(self.change, total, minlength=self.changes).astype(np.float64)

    def every(self, step: int) -> "Shares":
        """Shares of every `step`-th row."""
        return replace(self, row=self.row[::step], share=self.share[:, ::step], weight=self.weight[:, ::step])


def predicted(after: Floats, exposure_s: float) -> Floats:
    """Shares of what follows a change, in rows whose exposure has its middle so long `after` it; any shape."""
    return np.clip(after / exposure_s + 0.5, 0, 1)


def observe(samples: VideoSamples, programme: Programme, clocks: Clocks) -> Shares:
    """Estimate the shares from the light in the samples, under the clocks' tone curve."""
    frames, of_changes = list[Ints](), list[Ints]()
    before, after, alone = list[Light](), list[Light](), list[Bools]()
    per_loop = len(programme.loop) + 1
    for number, loop in enumerate(clocks.loops):
        times = clocks.changes(number)
        pictures = [_picture(samples, clocks, times[slot], times[slot + 1]) for slot in range(per_loop - 1)]
        for change in range(1, per_loop - 1):
            if programme.loop[change - 1] == programme.loop[change]:
                continue
            near = np.flatnonzero(np.abs(samples.times_s - times[change]) < _AROUND * loop.slot_s)
            near = near[:: max(1, len(near) // _FRAMES_PER_CHANGE)]
            frames.append(near)
            of_changes.append(np.full(len(near), number * per_loop + change))
            (earlier, earlier_alone), (later, later_alone) = pictures[change - 1], pictures[change]
            before.append(np.broadcast_to(earlier, (len(near), *earlier.shape)))
            after.append(np.broadcast_to(later, (len(near), *later.shape)))
            alone.append(np.broadcast_to(earlier_alone & later_alone, (len(near), len(earlier))))
    frame, of_change = np.concatenate(frames), np.concatenate(of_changes)
    light = samples.light(clocks.tone, frame)
    share, energy = _shares(light, np.concatenate(before), np.concatenate(after), samples)
    weight = np.sqrt(np.minimum(energy / max(float(np.median(energy)), 1e-9), 1.0))
    weight[energy < _LEAST_ENERGY * np.median(energy)] = 0
    weight *= np.concatenate(alone)[..., None]
    row, changes = samples.rows - samples.middle_row, per_loop * len(clocks.loops)
    return Shares(of_change, samples.times_s[frame], row, share, weight, changes)


def misfit(shares: Shares, clocks: Clocks) -> Floats:
    """Weighted differences (M, R, 2) of the shares from those that the clocks predict."""
    share = predicted(after_changes(shares, clocks), clocks.exposure_s)
    off: Floats = shares.weight * (shares.share - share[..., None])
    return off


def after_changes(shares: Shares, clocks: Clocks) -> Floats:
    """How long after the changes the exposures of rows have their middle, (M, R)."""
    return (shares.time_s - clocks.every_change[shares.change])[:, None] + shares.row * clocks.line_s


def independent_shares(shares: Shares, clocks: Clocks) -> float:
    """Number of independent shares as uncertain as all of them, whose misfits are alike where rows were exposed at the
    same time after a change: projectors respond, and cameras sharpen, as no clocks predict; or in all of a frame that
    came off its time.

    From the design effect of cluster samples (Kish, "Survey Sampling", 1965), without outliers.
    """
    effect = max(_design_effects(shares, clocks))
    return max(np.count_nonzero(shares.weight) / max(effect, 1.0), 2.0)


def frames_come_unevenly(shares: Shares, clocks: Clocks) -> bool:
    """Whether misfits are alike within frames rather than at one time after changes."""
    at_a_time, of_a_frame = _design_effects(shares, clocks)
    return of_a_frame > max(at_a_time, 1.0)


def _design_effects(shares: Shares, clocks: Clocks) -> tuple[float, float]:
    """Of clusters of shares at one time after changes, and in one frame."""
    off = np.clip(misfit(shares, clocks), -ROBUST, ROBUST)
    order = np.argsort(after_changes(shares, clocks).ravel())
    square = max(float(np.sum(off**2)), 1e-300)
    at_a_time = np.array([off.reshape(-1, 2)[part].sum(axis=0) for part in np.array_split(order, _CLUSTERS)])
    of_a_frame: Floats = off.reshape(len(off), -1).sum(axis=1)
    return float(np.sum(at_a_time**2)) / square, float(np.sum(of_a_frame**2)) / square


def loss(off: Floats) -> Floats:
    """Soft L1, as `least_squares` has it."""
    return 2 * ROBUST**2 * (np.sqrt(1 + (off / ROBUST) ** 2) - 1)


def mean_loss(shares: Shares, clocks: Clocks) -> float:
    """Of shares with a weight."""
    return float(loss(misfit(shares, clocks)).sum()) / max(int(np.count_nonzero(shares.weight)), 1)


def _picture(samples: VideoSamples, clocks: Clocks, begins: float, ends: float) -> tuple[Light, Bools]:
    """Light (R, C) of the rows that were exposed in the middle of a slot; and which (R,) show nothing else."""
    delays = clocks.row_delays(samples.rows, samples.middle_row)
    first, last = np.searchsorted(samples.times_s, (begins - np.ptp(delays), ends + np.ptp(delays)))
    frames = np.arange(max(first - 1, 0), min(last + 1, len(samples.times_s)))
    off = np.abs(samples.times_s[frames, None] + delays - (begins + ends) / 2)
    nearest = off.min(axis=0)
    chosen = off <= np.maximum(_MIDDLE * (ends - begins), nearest)
    weights = (chosen / chosen.sum(axis=0)).astype(np.float32)
    picture: Light = np.einsum("nr,nrc->rc", weights, samples.light(clocks.tone, frames))
    return picture, nearest <= (ends - begins - clocks.exposure_s) / 2


def _shares(light: Light, before: Light, after: Light, samples: VideoSamples) -> tuple[Floats, Floats]:
    """Shares (M, R, 2) by least squares over the columns, and the sums of squared differences that determine them."""
    usable = samples.lit & (np.maximum(before, after) < 1)
    differences = np.where(usable, after - before, 0)
    shares, energies = [], []
    for part in (np.maximum(differences, 0), np.minimum(differences, 0)):
        energy = np.einsum("mrc,mrc->mr", part, part)
        shares.append(np.einsum("mrc,mrc->mr", light - before, part) / np.maximum(energy, 1e-12))
        energies.append(energy)
    return np.clip(np.stack(shares, axis=2), -0.5, 1.5).astype(np.float64), np.stack(energies, axis=2).astype(
        np.float64
    )
