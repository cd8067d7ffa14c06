"""Linear equations for the motion of both devices in every frame of the fringes.

All fringes show the same scene under the same mean light, so that 1 + 2 F numbers per pixel explain N frames of F
fringes. To first order, a motion in a frame changes it by the slope of its fringe times the shift of the coordinate.
What remains of the frames beside light and fringes is linear in the motions of all frames, and so is the difference
between the positions of successive fringes of an axis. A motion along a trajectory in time is a projection of these
equations.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.numerics import Floats, Floats32, Ints, huber_weights, median
from scanner.decoding.motion.fringe_model import FringeFrames, FringeModel
from scanner.decoding.motion.pixels import COLUMNS, PRIOR_PX, MotionPixels
from scanner.decoding.significance import HUBER_SIGMAS, NEGLIGIBLE

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
