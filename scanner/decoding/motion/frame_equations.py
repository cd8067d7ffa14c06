"""Linear equations for the motion of both devices in every frame of the fringes, and the fringes' least-squares fit.

All fringes show the same scene under the same mean light, so that 1 + 2 F numbers per pixel explain N frames of F
fringes. To first order, a motion in a frame changes it by the slope of its fringe times the shift of the coordinate.
What remains of the frames beside light and fringes is linear in the motions of all frames, and so is the difference
between the positions of successive fringes of an axis. A motion along a trajectory in time is a projection of these
equations.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from calib.numerics import Floats, Floats32, Ints, huber_weights, median, robust_sigma
from scanner.decoding.motion.fringe_pixels import MotionPixels
from scanner.decoding.motion.rigid_motion import COLUMNS, PRIOR_PX
from scanner.decoding.sequence_plan import Fringe, SequencePlan
from scanner.decoding.significance import HUBER_SIGMAS, NEGLIGIBLE

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


UNKNOWNS = COLUMNS + 1  # of a frame: the motion of both devices, and the share of the frame before
_OF_LIGHT = 4  # unknowns of a frame's light


@dataclass(frozen=True)
class EquationBlock:
    """Equations at P pixels, in standard deviations: observed = mix @ the changes of n frames."""

    numbers: Ints
    """(n,): of the frames."""
    columns: Floats32
    """(A, n, P): derivatives of the changes by A unknowns of each frame."""
    mix: Floats
    """(n, n)"""
    observed: Floats32
    """(n, P)"""

    @property
    def normal(self) -> Floats:
        """The normal matrix (A n, A n)."""
        flat = self.columns.reshape(-1, self.observed.shape[1])
        return np.asarray(flat @ flat.T, np.float64) * np.tile(self.mix, (len(self.columns), len(self.columns)))

    @property
    def right(self) -> Floats:
        """The right-hand side (A n,)."""
        return np.asarray(np.einsum("anp,np->an", self.columns, self.observed).reshape(-1), np.float64)

    def change(self, unknowns: Floats) -> Floats:
        """Return what unknowns (A, N) of all frames explain, (n, P)."""
        parts = min(len(unknowns), len(self.columns))
        of_frames = unknowns[:parts, self.numbers].astype(np.float32)
        return np.asarray(self.mix @ np.einsum("anp,an->np", self.columns[:parts], of_frames))


@dataclass(frozen=True)
class Projection:
    """The motion along some directions of the unknowns."""

    directions: Floats
    """(A N, U)"""
    values: Floats
    """(U,): how far along each."""
    information: Floats
    """(U, U): of the values, with their prior."""
    gained: float
    """The decrease of χ²."""

    @property
    def of_frames(self) -> Floats:
        """(A N,): unknowns of all frames."""
        return self.directions @ self.values


@dataclass(frozen=True)
class FrameEquations:
    """Equations for A unknowns of each of N frames, ordered by kind, then by frame."""

    frames: FringeFrames
    """Of the fringes."""
    tile: Ints
    """(P,): in which the pixels are."""
    blocks: tuple[EquationBlock, ...]
    """The first has unknowns of the frames' light as well, which count as nuisance: a gain and an offset of each frame,
    and the second harmonic of each fringe, the same in all pixels, that a nonlinear brightness curve leaves.
    """

    @cached_property
    def _beside_light(self) -> tuple[Floats, Floats]:
        """(A N, (A + 4) N): derivatives by the unknowns without what light explains, from those with the light's; and
        the light at rest, as unknowns ((A + 4) N,).
        """
        frames, block = self.frames, self.blocks[0]
        count, moved = len(frames.times), self._unknowns
        of_fringe = frames.of_fringe[:, None] == np.arange(len(frames.fringes))
        light = np.zeros((_OF_LIGHT * count, 2 * (count + len(frames.fringes))))
        light[: 2 * count, : 2 * count] = np.eye(2 * count)
        light[2 * count :, 2 * count :] = np.kron(np.eye(2), of_fringe)
        normal = self._normal_of_frames[:, moved:] @ light
        by_light = np.linalg.solve(light.T @ normal[moved:] + np.eye(light.shape[1]), light.T)
        beside = np.concatenate([np.eye(moved), -normal[:moved] @ by_light], axis=1)
        return beside, np.append(np.zeros(moved), light @ by_light @ block.right[moved:])

    @property
    def _unknowns(self) -> int:
        return (len(self.blocks[0].columns) - _OF_LIGHT) * len(self.frames.times)

    @cached_property
    def _normal_of_frames(self) -> Floats:
        return self.blocks[0].normal

    @cached_property
    def _normal(self) -> tuple[Floats, Floats]:
        """The normal matrix (A N, A N), and the right-hand side (A N,)."""
        of_frames, *of_positions = self.blocks
        beside, _ = self._beside_light
        normal, right = beside @ self._normal_of_frames[:, : len(beside)], beside @ of_frames.right
        for block in of_positions:
            places = self._places(block)
            normal[np.ix_(places, places)] += block.normal
            right[places] += block.right
        return normal, right

    def _places(self, block: EquationBlock) -> Ints:
        """Return the places of a block's unknowns among those of all frames."""
        places: Ints = np.arange(len(block.columns))[:, None] * len(self.frames.times) + block.numbers
        return places.reshape(-1)

    def along(self, directions: Floats, known: Floats | float = 0.0) -> Projection:
        """Return the motion along some directions (A N, U) that explains most, beside what is `known` (U,) of it and
        was removed from the frames.
        """
        normal, right = self._normal
        information = directions.T @ normal @ directions + np.eye(directions.shape[1]) / PRIOR_PX**2
        towards = directions.T @ right - known / PRIOR_PX**2
        values = np.linalg.solve(information, towards).astype(np.float64)
        return Projection(directions, values, information, float(towards @ values))

    def _left(self, motions: Floats | None = None) -> list[Floats]:
        """Return what light and the motions (A N,) of the frames do not explain, (n, P) per block."""
        beside, light = self._beside_light
        unknowns = light if motions is None else light + motions @ beside
        unknowns = unknowns.reshape(-1, len(self.frames.times))
        return [block.observed - block.change(unknowns) for block in self.blocks]

    def variance(self, motions: Floats | None = None) -> float:
        """Return the variance of what light and motions (A N,) leave of the frames, relative to noise."""
        return _variance(self._left(motions)[0], self.blocks[0].mix)

    def covariance(self, projection: Projection) -> Floats:
        """Return the covariance (U, U) of what was found, from the scatter between tiles."""
        residuals = self._left(projection.of_frames)
        of_frames, *of_positions = (
            self._of_tiles(block.columns * of_block) for block, of_block in zip(self.blocks, residuals, strict=True)
        )
        scores = self._beside_light[0] @ of_frames
        for block, of_block in zip(self.blocks[1:], of_positions, strict=True):
            scores[self._places(block)] += of_block
        sums, inverse = projection.directions.T @ scores, np.linalg.inv(projection.information)
        noise = _variance(residuals[0], self.blocks[0].mix)
        covariance: Floats = inverse @ (sums @ sums.T) @ inverse + noise * inverse
        return covariance

    def _of_tiles(self, values: Floats) -> Floats:
        """Return the sums of values (A, n, P) within each tile, (A n, T)."""
        flat = values.reshape(-1, values.shape[2])
        return np.add.reduceat(flat, np.flatnonzero(np.diff(self.tile, prepend=-1)), axis=1)

    def explained(self, motions: Floats, without: "FrameEquations") -> float:
        """Return the share of what is seen along the motions (A N,), at a typical pixel, that is not seen `without` it:
        in frames from which it was removed.
        """
        of_all = []
        for block, before, after in zip(self.blocks, self._left(), without._left(), strict=True):
            along = block.change(motions.reshape(-1, len(self.frames.times)))
            along /= np.sqrt(np.maximum(np.sum(along**2, axis=0), NEGLIGIBLE))
            of_all.append([np.sum(along * residual, axis=0) ** 2 for residual in (before, after)])
        before, after = np.concatenate(of_all, axis=1)
        return 1.0 - median(after) / max(median(before), 1e-12)


def of_frames(model: FringeModel, by_unknowns: Floats32, noise: Floats) -> EquationBlock:
    """Return what light and fringes do not explain of the frames, whose derivatives (A, N, P) are given."""
    frames = model.frames
    mix = np.eye(len(frames.times)) - frames.design @ frames.weights
    root = 1 / np.sqrt(noise)
    root *= _root_weights(model.residuals * root, mix)
    phase, amplitude = model.waves
    columns = np.empty((len(by_unknowns) + _OF_LIGHT, *phase.shape), np.float32)
    np.multiply(by_unknowns, root.astype(np.float32), out=columns[:-4])
    columns[-4] = (model.levels - model.residuals) * root
    columns[-3] = model.light * root
    columns[-2], columns[-1] = (amplitude * wave(2 * phase) * root for wave in (np.cos, np.sin))
    return EquationBlock(np.arange(len(frames.times)), columns, mix, (model.residuals * root).astype(np.float32))


def of_positions(model: FringeModel, pixels: MotionPixels, longer: int, shorter: int) -> EquationBlock:
    """Return the difference between the positions of two successive fringes, by the motion of their frames."""
    frames = model.frames
    numbers = np.flatnonzero(np.isin(frames.of_fringe, (longer, shorter)))
    sign = np.where(frames.of_fringe[numbers] == shorter, 1, -1)[:, None]
    apart, variance = model.between(longer, shorter, pixels)
    mix, root = np.ones((len(numbers), len(numbers))), 1 / np.sqrt(variance)
    observed = np.broadcast_to(apart, (len(numbers), len(apart)))
    root *= _root_weights(observed * root, mix)
    changes = (sign * model.responses[numbers] * root).astype(np.float32)
    return EquationBlock(
        numbers, pixels.by_motion32[:, frames.axis[numbers]] * changes, mix, (observed * root).astype(np.float32)
    )


def equations_of_motion(model: FringeModel, pixels: MotionPixels) -> FrameEquations:
    """Return the equations for the motion (8,) of both devices in each frame, and for its share of the frame before."""
    by_motion = pixels.by_motion32[:, model.frames.axis] * model.slopes.astype(np.float32)
    by_unknowns = np.concatenate([by_motion, model.from_before[None].astype(np.float32)])
    positions = (of_positions(model, pixels, *both) for both in model.frames.successive)
    return FrameEquations(model.frames, pixels.tile, (of_frames(model, by_unknowns, pixels.noise), *positions))


def _root_weights(residuals: Floats, mix: Floats) -> Floats:
    """Return the square roots (P,) of the Huber weights of pixels with residuals (n, P), in standard deviations."""
    variance = np.sum(residuals**2, axis=0) / max(float(np.trace(mix)), 1.0)
    sigmas = np.sqrt(np.maximum(variance / max(_variance(residuals, mix), 1e-12), 1e-9))
    return np.sqrt(huber_weights(sigmas, HUBER_SIGMAS))


def _variance(residuals: Floats, mix: Floats) -> float:
    """Return the variance of residuals (n, P) of `mix`, without outliers.

    The median of χ² is nearly k (1 − 2/9k)³ (Wilson and Hilferty, PNAS 17, 1931).
    """
    freedom = max(float(np.trace(mix)), 1.0)
    return median(np.sum(residuals**2, axis=0)) / (freedom * (1 - 2 / (9 * freedom)) ** 3)
