"""What shifts that no residual shows do to a room: to first order, as in `calib.refinement.systematic_shifts`.

The smooth errors that a decoder is known for are mostly shown by a room's residuals, as one corner's are not: every
station sees several planes, and places and planes take up a few of each one's twenty polynomials. What residuals show
is in the cells' variances already. Beyond that errors can only be as large as passes for chance.
"""

from collections.abc import Sequence

import numpy as np

from calib.estimation.likelihood import AnyLayout, Fit, Part
from calib.estimation.noise import NoiseLevels
from calib.numerics import CUBIC, Bools, Floats, by_pixel, orthonormal_polynomials
from calib.refinement import Shifts


def covariance_of_shifts(
    patches: Sequence[Part[AnyLayout]],
    fit: Fit[AnyLayout],
    variances: Sequence[Floats],
    free: Bools,
    levels: NoiseLevels,
    shifts: Sequence[Shifts],
) -> Floats:
    """The covariance (size, size) of the room due to the `shifts` of each station, independent between stations.

    Stations at one place have the same errors, and are shifted together.
    """
    columns = np.flatnonzero(free)
    covariance = np.zeros_like(fit.information)
    hidden = [_hidden_px(patches, variances, station, len(columns) / len(patches)) for station in range(len(shifts))]
    for station, of_station in enumerate(shifts):
        every = (*of_station.likely, *of_station.possible)
        together = np.zeros((fit.layout.size, len(every)))
        apart = []
        for patch, variance in zip(patches, variances, strict=True):
            if patch.capture != station:
                continue
            if every:
                at = patch.cells.camera_px, patch.cells.projector_px, _gradient(fit.layout, patch)
                together += _pull(fit.layout, patch, variance, np.stack([shift(*at) for shift in every], axis=2))
            if of_station.smooth_px:
                smooth_px = min(of_station.smooth_px, hidden[station])
                apart.append(_pull(fit.layout, patch, variance, smooth_px * _fields(patch)))
        pull = np.concatenate([together, *apart], axis=1)[columns]
        if pull.shape[1]:
            moved = np.linalg.solve(fit.information[np.ix_(columns, columns)], pull)
            covariance[np.ix_(columns, columns)] += levels.stations[station].repeats * moved @ moved.T
    return covariance


def _hidden_px(patches: Sequence[Part[AnyLayout]], variances: Sequence[Floats], station: int, absorbed: float) -> float:
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


def _fields(patch: Part[AnyLayout]) -> Floats:
    """Every polynomial up to the cubic ones over a patch, orthonormal in the mean, along either axis, (M, 2, 2 K)."""
    modes = orthonormal_polynomials(patch.cells.camera_px)
    along = np.zeros((len(patch.cells), 2, 2 * modes.shape[1]))
    along[:, 0, : modes.shape[1]] = along[:, 1, modes.shape[1] :] = np.sqrt(len(patch.cells)) * modes
    return along


def _pull(layout: AnyLayout, patch: Part[AnyLayout], variance: Floats, fields: Floats) -> Floats:
    """Σ Jᵀ s / v for fields s (M, 2, K), (size, K)."""
    _, jacobian, _ = patch.predict(layout)
    own = np.einsum("nac,nak->ck", jacobian / variance[:, None, None], fields, optimize=True)
    pull = np.zeros((layout.size, fields.shape[2]))
    pull[patch.columns(layout)] = patch.carried(layout).T @ own
    return pull


def _gradient(layout: AnyLayout, patch: Part[AnyLayout]) -> Floats:
    """Of the projector's pixels (rows) by the camera's, (M, 2, 2)."""
    return by_pixel(lambda pixels: patch.predict(layout, pixels)[0], patch.cells.camera_px)
