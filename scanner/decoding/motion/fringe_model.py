"""The frames of all fringes, and the fringes in some pixels: their least-squares fit, and its first-order response to
motion in the frames.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from calib.numerics import Floats, Ints, median, robust_sigma
from scanner.decoding.motion.pixels import MotionPixels
from scanner.decoding.sequence_plan import Fringe, SequencePlan
from scanner.decoding.significance import NEGLIGIBLE

# Errors from nonlinear brightness curves and interreflection grow with the period: a much longer one is useless.
_COMPARABLE = 4.0


@dataclass(frozen=True)
class FringeFrames:
    """The N frames of F fringes, in the order of time."""

    fringes: tuple[Fringe, ...]
    """Those of x, then of y, each from the longest."""
    times: Ints
    """(N,): places in the sequence, with repeats."""
    of_fringe: Ints
    """(N,): number of the fringe."""
    angles: Floats
    """(N, 1): of the phase steps."""

    @cached_property
    def axis(self) -> Ints:
        """(N,): 0 for x, 1 for y."""
        return np.array([fringe.axis == "y" for fringe in self.fringes], np.int64)[self.of_fringe]

    @cached_property
    def steepness(self) -> Floats:
        """(N, 1): radians of the phase per px of the coordinate."""
        return 2 * np.pi / np.array([fringe.period for fringe in self.fringes])[self.of_fringe, None]

    @cached_property
    def design(self) -> Floats:
        """(N, 1 + 2 F): derivatives of the frames by the light, which all fringes share, and by A cos θ and A sin θ of
        each fringe.
        """
        waves = np.concatenate([np.cos(self.angles), -np.sin(self.angles)], axis=1)
        own = (self.of_fringe[:, None] == np.arange(len(self.fringes)))[:, :, None] * waves[:, None]
        return np.concatenate([np.ones((len(own), 1)), own.reshape(len(own), -1)], axis=1)

    @cached_property
    def weights(self) -> Floats:
        """(1 + 2 F, N): least squares of the parameters of the design."""
        return np.asarray(np.linalg.pinv(self.design), np.float64)

    @property
    def shortest(self) -> tuple[int, int]:
        """Numbers of the shortest fringes of x and y."""
        return sum(fringe.axis == "x" for fringe in self.fringes) - 1, len(self.fringes) - 1

    @cached_property
    def successive(self) -> list[tuple[int, int]]:
        """Numbers of two fringes of an axis, the longer one first, whose periods are comparable."""
        return [
            (number, number + 1)
            for number, (longer, shorter) in enumerate(pairwise(self.fringes))
            if longer.axis == shorter.axis and longer.period <= _COMPARABLE * shorter.period
        ]


def fringe_frames(plan: SequencePlan) -> FringeFrames:
    """Return the frames of all fringes of a sequence, at least one."""
    steps = sorted(
        (int(time), number, float(shift))
        for number, fringe in enumerate(plan.fringes)
        for time, shift in zip(*plan.times_of(fringe), strict=True)
    )
    times, of_fringe, shifts = (np.array(column) for column in zip(*steps, strict=True))
    return FringeFrames(plan.fringes, times, of_fringe, 2 * np.pi * shifts[:, None])


@dataclass(frozen=True)
class FringeModel:
    """The fit of N `frames` with grey `levels` (N, P) at P pixels by I_n = o + A cos(θ + 2π s_n)."""

    frames: FringeFrames
    levels: Floats

    @cached_property
    def _parameters(self) -> Floats:
        """(1 + 2 F, P): the light, A cos θ and A sin θ of each fringe."""
        return self.frames.weights @ self.levels

    @property
    def light(self) -> Floats:
        """(P,): the mean light."""
        light: Floats = self._parameters[0]
        return light

    @cached_property
    def residuals(self) -> Floats:
        """(N, P): what light and fringes leave."""
        return self.levels - self.frames.design @ self._parameters

    @cached_property
    def _components(self) -> Floats:
        """(2, F, P): A cos θ and A sin θ."""
        return self._parameters[1:].reshape(len(self.frames.fringes), 2, -1).transpose(1, 0, 2)

    @cached_property
    def waves(self) -> tuple[Floats, Floats]:
        """Phase and amplitude (N, P) of the fringe in each frame."""
        cosine, sine = self._components
        phase, amplitude = np.arctan2(sine, cosine), np.hypot(cosine, sine)
        return phase[self.frames.of_fringe] + self.frames.angles, amplitude[self.frames.of_fringe]

    @cached_property
    def slopes(self) -> Floats:
        """(N, P): derivatives of the frames by the coordinate."""
        phase, amplitude = self.waves
        return -self.frames.steepness * amplitude * np.sin(phase)

    @property
    def from_before(self) -> Floats:
        """(N, P): changes of the frames by their share of the one shown just before; 0 if that is no fringe."""
        times = self.frames.times[:, None]
        return np.where(np.diff(times, axis=0, prepend=-2) == 1, np.roll(self.levels, 1, axis=0) - self.levels, 0.0)

    @cached_property
    def _position_by_level(self) -> Floats:
        """(N, P): derivatives of the position of each frame's fringe by the grey level, in px."""
        frames, every = self.frames, np.arange(len(self.frames.times))
        by_level = frames.weights[1:].reshape(len(frames.fringes), 2, -1)[frames.of_fringe, :, every]
        cosine, sine = self._components[:, frames.of_fringe]
        turned = cosine * by_level[:, 1:] - sine * by_level[:, :1]
        return np.asarray(turned / (frames.steepness * np.maximum(cosine**2 + sine**2, NEGLIGIBLE)))

    @cached_property
    def responses(self) -> Floats:
        """(N, P): derivatives of the position of each frame's fringe by the coordinate in this frame."""
        return self._position_by_level * self.slopes

    def between(self, longer: int, shorter: int, pixels: MotionPixels) -> tuple[Floats, Floats]:
        """Return the difference (P,) between the positions of two fringes of an axis, and its variance (P,).

        Besides noise, the variance contains the scatter within a tile due to interreflection and nonlinear brightness
        curves.
        """
        both = np.isin(self.frames.of_fringe, (longer, shorter))
        cosine, sine = self._components
        periods = [self.frames.fringes[fringe].period for fringe in (longer, shorter)]
        before, after = (
            np.arctan2(sine[fringe], cosine[fringe]) * period / (2 * np.pi)
            for fringe, period in zip((longer, shorter), periods, strict=True)
        )
        coarse = pixels.projector_px[:, self.frames.axis[both][0]]
        before += periods[0] * np.rint((coarse - before) / periods[0])
        apart = after - before + periods[1] * np.rint((before - after) / periods[1])
        within = apart - (np.bincount(pixels.tile, apart) / np.maximum(np.bincount(pixels.tile), 1))[pixels.tile]
        spread = robust_sigma(within)
        noise = np.sum(self._position_by_level[both] ** 2, axis=0) * pixels.noise
        return apart, noise + max(spread**2 - median(noise), 0.0)

    def without(self, moved_px: Floats) -> "FringeModel":
        """Return the fit of the frames without known motions (N, P) of the coordinates, beyond first order."""
        frames, levels = self.frames, self.levels.copy()
        moved = frames.angles + frames.steepness * moved_px
        for fringe in range(len(frames.fringes)):
            of_it = frames.of_fringe == fringe
            design = np.stack([np.ones_like(moved[of_it]), np.cos(moved[of_it]), -np.sin(moved[of_it])])
            normal, right = np.einsum("anp,bnp->pab", design, design), np.einsum("anp,np->pa", design, levels[of_it])
            (_, cosine, sine) = np.linalg.solve(normal, right[..., None])[..., 0].T
            at_rest = np.stack([np.cos(frames.angles[of_it]), -np.sin(frames.angles[of_it])])
            levels[of_it] += cosine * (at_rest[0] - design[1]) + sine * (at_rest[1] - design[2])
        return replace(self, levels=levels)
