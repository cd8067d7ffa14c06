"""The share of the later of two pictures in each row of the frames around a change."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Floats, Ints
from scanner.recordings.clocks import Clocks
from scanner.recordings.programme import Programme
from scanner.recordings.samples import Light, VideoSamples

_AROUND = 0.6  # slots before and after a change
_FRAMES_PER_CHANGE = 10  # more frames, of a fast camera, add no information
_MIDDLE = 0.15  # slots; frames this close to a slot's middle show its picture
ROBUST = 0.05  # limit of a share; larger deviations are no noise
_LEAST_ENERGY = 1e-3  # relative to the usual; less gives no information


@dataclass(frozen=True)
class Shares:
    """Shares of M frames near changes: numbers (M,) of `frame` and `change` (through all loops).

    `share` (M, R, 2), from pixels that brighten and from those that darken, with `weight` of the same shape; `seen`
    (changes,): sum of the weights.
    """

    frame: Ints
    change: Ints
    share: Floats
    weight: Floats
    seen: Floats


def predicted(times: Floats, changes: Floats, delays: Floats, exposure_s: float) -> Floats:
    """Shares (M, R) of what follows the `changes` (M,) in frames of `times` (M,), in rows with `delays` (R,)."""
    after = (times - changes)[:, None] + delays + exposure_s / 2
    return np.clip(after / exposure_s, 0, 1)


def observe(samples: VideoSamples, programme: Programme, clocks: Clocks) -> Shares:
    """Estimate the shares from the light in the samples, under the clocks' tone curve."""
    frames, changes = list[Ints](), list[Ints]()
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
            changes.append(np.full(len(near), number * per_loop + change))
            (earlier, earlier_alone), (later, later_alone) = pictures[change - 1], pictures[change]
            before.append(np.broadcast_to(earlier, (len(near), *earlier.shape)))
            after.append(np.broadcast_to(later, (len(near), *later.shape)))
            alone.append(np.broadcast_to(earlier_alone & later_alone, (len(near), len(earlier))))
    frame, of_change = np.concatenate(frames), np.concatenate(changes)
    seen = samples.light(clocks.tone, frame)
    share, energy = _shares(seen, np.concatenate(before), np.concatenate(after), samples)
    weight = np.sqrt(np.minimum(energy / max(float(np.median(energy)), 1e-9), 1.0))
    weight[energy < _LEAST_ENERGY * np.median(energy)] = 0
    weight *= np.concatenate(alone)[..., None]
    total_weight = summed(of_change, weight.sum(axis=(1, 2)), per_loop * len(clocks.loops))
    return Shares(frame, of_change, share, weight, total_weight)


def summed(group: Ints, values: Floats, groups: int) -> Floats:
    """(groups,): the sum of the values (n,) of each group."""
    return np.bincount(group, values, minlength=groups).astype(np.float64)


def misfit(samples: VideoSamples, shares: Shares, clocks: Clocks) -> Floats:
    """Weighted differences (M · R · 2,) of the shares from those that the clocks predict."""
    changes = np.concatenate([clocks.changes(number) for number in range(len(clocks.loops))])[shares.change]
    delays = clocks.row_delays(samples.rows, samples.middle_row)
    share = predicted(samples.times_s[shares.frame], changes, delays, clocks.exposure_s)
    off: Floats = shares.weight * (shares.share - share[..., None])
    return off.ravel()


def loss(off: Floats) -> Floats:
    """Soft L1, as `least_squares` has it."""
    return 2 * ROBUST**2 * (np.sqrt(1 + (off / ROBUST) ** 2) - 1)


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


def _shares(seen: Light, before: Light, after: Light, samples: VideoSamples) -> tuple[Floats, Floats]:
    """Shares (M, R, 2) by least squares over the columns, and the sums of squared differences that determine them."""
    usable = samples.lit & (np.maximum(before, after) < 1)
    differences = np.where(usable, after - before, 0)
    shares, energies = [], []
    for part in (np.maximum(differences, 0), np.minimum(differences, 0)):
        energy = np.einsum("mrc,mrc->mr", part, part)
        shares.append(np.einsum("mrc,mrc->mr", seen - before, part) / np.maximum(energy, 1e-12))
        energies.append(energy)
    return np.clip(np.stack(shares, axis=2), -0.5, 1.5).astype(np.float64), np.stack(energies, axis=2).astype(
        np.float64
    )
