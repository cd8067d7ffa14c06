"""Covariances of what residuals do not show, to first order: smooth shifts of matches, and planes that are not flat.

The smooth errors that a decoder is known for are mostly shown by a room's residuals, as one corner's are not: every
station sees several planes, and places and planes take up a few of each one's twenty polynomials. What residuals show
is in the cells' variances already. Beyond that errors can only be as large as passes for chance
(`calib.refinement.systematic_shifts`).

Plaster and floors deviate by millimetres, far beyond the noise of matches. A plane with such residuals is modelled with
heights of random waves over its visible part, longer waves being higher. Their amplitude follows from the residuals, of
which the fit has absorbed a known part. To first order, the waves move the room like shifts of the matches. Stations
that see one wall see the same waves.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic

import numpy as np

from calib.estimation.noise import NoiseLevels
from calib.estimation.problem import AnyLayout, AnyPlanes, Fit, Part, PlanePart, Problem
from calib.geometry import tangent_basis
from calib.numerics import CUBIC, Floats, Ints, by_pixel, orthonormal_polynomials

# Camera pixels (N, 2), projector pixels (N, 2), and their gradient (N, 2, 2) (rows) by the camera's x and y → the shift
# (N, 2) of the projector pixels.
Shift = Callable[[Floats, Floats, Floats], Floats]


@dataclass(frozen=True)
class Shifts:
    """Possible shift fields of a capture's matches, of one standard deviation each: `likely` ones, and undetectable
    `possible` ones. `smooth_px`: smooth decoding error over each plane along either axis, as the standard deviation of
    the amplitude of every polynomial up to cubic, orthonormal in the mean. `decoding`: other decoding errors, which
    occur with or without motion.
    """

    likely: tuple[Shift, ...] = ()
    possible: tuple[Shift, ...] = ()
    smooth_px: float = 0.0
    decoding: tuple[Shift, ...] = ()


def covariance_of_shifts(
    problem: Problem[AnyPlanes, PlanePart[AnyPlanes]],
    fit: Fit[AnyPlanes],
    levels: NoiseLevels,
    shifts: Sequence[Shifts],
) -> Floats:
    """The covariance (size, size) of the room due to the `shifts` of each station, independent between stations.

    Stations at one place have the same errors, and are shifted together.
    """
    patches, variances, columns = problem.parts, problem.variances, np.flatnonzero(problem.free)
    covariance = np.zeros_like(fit.information)
    hidden = [_hidden_px(patches, variances, station, len(columns) / len(patches)) for station in range(len(shifts))]
    for station, of_station in enumerate(shifts):
        every = (*of_station.likely, *of_station.possible)
        together = np.zeros((fit.state.size, len(every)))
        apart = []
        for patch, variance in zip(patches, variances, strict=True):
            if patch.capture != station:
                continue
            if every:
                at = patch.cells.camera_px, patch.cells.projector_px, _gradient(fit.state, patch)
                together += pull_of_shifts(
                    fit.state, patch, variance, np.stack([shift(*at) for shift in every], axis=2)
                )
            if of_station.smooth_px:
                smooth_px = min(of_station.smooth_px, hidden[station])
                apart.append(
                    pull_of_shifts(fit.state, patch, variance, smooth_px * smooth_fields(patch.cells.camera_px))
                )
        pull = np.concatenate([together, *apart], axis=1)
        if pull.shape[1]:
            moved = problem.response(fit, pull)[columns]
            covariance[np.ix_(columns, columns)] += levels.stations[station].repeats * moved @ moved.T
    return covariance


def _hidden_px(
    patches: Sequence[PlanePart[AnyPlanes]], variances: Sequence[Floats], station: int, absorbed: float
) -> float:
    """How large each of a station's smooth errors may be, as of `Shifts.smooth_px`, before its residuals show it.

    Of a patch with M cells of variance v each polynomial's amplitude has the variance v / M by chance. Errors of the
    variance s² add s² M / v to χ² for each of the F that the fit has not `absorbed`, which is √(2 F) off by chance.
    """
    own = [
        len(patch.cells) / float(np.mean(variance))
        for patch, variance in zip(patches, variances, strict=True)
        if patch.capture == station
    ]
    if not own:
        return np.inf
    freedom = len(own) * (2 * CUBIC - absorbed)
    return float(np.sqrt(np.sqrt(2 / freedom) / np.mean(own))) if freedom > 1 else np.inf


def smooth_fields(camera_px: Floats) -> Floats:
    """Every polynomial up to the cubic ones over pixels (M, 2), orthonormal in the mean, along either axis.

    They are (M, 2, 2 K).
    """
    modes = orthonormal_polynomials(camera_px)
    along = np.zeros((len(camera_px), 2, 2 * modes.shape[1]))
    along[:, 0, : modes.shape[1]] = along[:, 1, modes.shape[1] :] = np.sqrt(len(camera_px)) * modes
    return along


def pull_of_shifts(layout: AnyLayout, part: Part[AnyLayout], variance: Floats, fields: Floats) -> Floats:
    """Σ Jᵀ s / v for fields s (M, 2, K) over a part's cells, (size, K)."""
    _, jacobian, _ = part.predict(layout)
    own = np.einsum("nac,nak->ck", jacobian / variance[:, None, None], fields, optimize=True)
    carried = part.carried(layout)
    pull = np.zeros((layout.size, fields.shape[2]))
    pull[part.columns(layout)] = own if carried is None else carried.T @ own
    return pull


def _gradient(layout: AnyPlanes, patch: PlanePart[AnyPlanes]) -> Floats:
    """Of the projector's pixels (rows) by the camera's, (M, 2, 2)."""
    return by_pixel(lambda pixels: patch.predict(layout, pixels)[0], patch.cells.camera_px)


_ORDERS = 6  # half-waves along either side of the visible part of a plane
_LEAST_LEFT = 1e-3  # share of the waves left by the fit; with less, residuals do not determine their heights


def covariance_of_waves(
    problem: Problem[AnyPlanes, PlanePart[AnyPlanes]],
    fit: Fit[AnyPlanes],
    levels: NoiseLevels,
) -> tuple[Floats, Floats]:
    """The covariance (size, size) that the waves of planes which are not flat give the room.

    With it their root mean square heights (P,) in baselines; 0 for planes that may be flat.
    """
    covariance, heights = np.zeros_like(fit.information), np.zeros(len(fit.state.planes))
    for plane in np.flatnonzero(levels.planes > 1).tolist():
        on_plane = [
            _Waves(fit, patch, residual, variance)
            for patch, residual, variance in zip(problem.parts, fit.residuals, problem.variances, strict=True)
            if patch.plane == plane
        ]
        modes = modes_over([waves.patch.points(fit.state) for waves in on_plane], fit.state.planes[plane].normal)
        pull = np.sum([waves.pull(of_patch) for waves, of_patch in zip(on_plane, modes, strict=True)], axis=0)
        moved = problem.response(fit, pull)
        remaining, whole = (
            sum(waves.energy_left(of_patch, after) for waves, of_patch in zip(on_plane, modes, strict=True))
            for after in (moved, np.zeros_like(moved))
        )
        if remaining < _LEAST_LEFT * whole:
            continue
        energy = sum(waves.energy() for waves in on_plane)
        # Variances on the plane were enlarged by the waves; this is the noise without them.
        noise = len(on_plane) * CUBIC / levels.planes[plane]
        variance = max(energy - noise, 0.0) / remaining
        covariance += variance * moved @ moved.T
        heights[plane] = np.sqrt(variance * np.mean(np.sum(np.concatenate(modes) ** 2, axis=1)))
    return covariance, heights


class _Waves(Generic[AnyPlanes]):
    """One patch of a plane, and what heights (M,) of the plane under its cells do."""

    def __init__(self, fit: Fit[AnyPlanes], patch: PlanePart[AnyPlanes], residual: Floats, variance: Floats) -> None:
        self.fit, self.patch = fit, patch
        _, self.jacobian, _ = patch.predict(fit.state)
        self.by_height = self.jacobian[:, :, -1]
        self.root = np.linalg.norm(self.by_height, axis=1) / np.sqrt(variance)
        self.variance, self.residual = variance, residual
        self.low = orthonormal_polynomials(patch.cells.camera_px, self.root)
        self.columns: Ints = patch.columns(fit.state)

    def pull(self, modes: Floats) -> Floats:
        """Σ Jᵀ s / v of the shifts s by modes (M, K), (size, K)."""
        weighted = np.einsum("nac,na->nc", self.jacobian, self.by_height / self.variance[:, None])
        pull = np.zeros((self.fit.state.size, modes.shape[1]))
        pull[self.columns] = self.patch.carried(self.fit.state).T @ (weighted.T @ modes)
        return pull

    def energy(self) -> float:
        """What the residuals have of heights in long waves, over their variances."""
        return self._in_long_waves(self.residual[:, :, None])

    def energy_left(self, modes: Floats, moved: Floats) -> float:
        """The same for modes (M, K), all together, where the fit has followed them by steps (size, K)."""
        own = self.patch.carried(self.fit.state) @ moved[self.columns]
        return self._in_long_waves(self.by_height[:, :, None] * modes[:, None, :] - self.jacobian @ own)

    def _in_long_waves(self, shifts: Floats) -> float:
        heights = np.einsum("na,nak->nk", self.by_height, shifts) / np.sum(self.by_height**2, axis=1)[:, None]
        return float(np.sum((self.low.T @ (heights * self.root[:, None])) ** 2))


def modes_over(points: Sequence[Floats], normal: Floats, margin: float = 0.0) -> list[Floats]:
    """Cosines over the bounding rectangle of the points (M, 3) of each patch on a plane, with heights proportional to
    their lengths. `margin`: around it, of its longer side.
    """
    places = [positions @ tangent_basis(normal) for positions in points]
    every = np.concatenate(places)
    sides = np.maximum(np.ptp(every, axis=0), 1e-12)
    low, sides = every.min(axis=0) - margin * sides.max(), sides + 2 * margin * sides.max()
    orders = np.stack(np.meshgrid(*[np.arange(_ORDERS + 1)] * 2), axis=-1).reshape(-1, 2)[1:]
    height = sides.max() / np.hypot(*(orders * (sides.max() / sides)).T)  # relative to the wave's number: its length
    return [np.cos(np.pi * ((place - low) / sides)[:, None, :] * orders).prod(axis=2) * height for place in places]
