"""The report's plots: curves over the camera's focal length, and histograms of residuals."""

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from calib.numerics import Floats
from calib.self_calibration import Profile
from scanner.reporting.svg import Plot, Scale

_HISTOGRAM_BINS = 81
_SIGMAS_SHOWN = 4.0
_HIGHEST_OF_LOWEST = 300.0  # times the lowest objective; larger values are not plotted
_ROOM_BELOW = 0.7


def likelihood_plot(profile: Profile, chosen_focal_px: float) -> Markup:
    """The posterior in sigmas, √(−2 log posterior above the best), with the answer marked."""
    sigmas = np.sqrt(np.maximum(profile.cost, 0.0))
    # Slightly larger than the plot, so that the curve leaves it at the edge.
    within = np.flatnonzero(sigmas <= 1.5 * _SIGMAS_SHOWN)
    focal = profile.focal_px[within]
    low, high = float(focal.min()), float(focal.max())
    if low == high:
        low, high = 0.99 * low, 1.01 * high
    plot = Plot(
        Scale(low, high, "focal length of the camera (px)"),
        Scale(0.0, _SIGMAS_SHOWN, "standard deviations"),
        "how well the focal length is determined",
    )
    plot.mark_y(1.0, "1 σ")
    plot.mark_y(3.0, "3 σ")
    plot.line(focal, sigmas[within])
    plot.mark_x(chosen_focal_px, f"{chosen_focal_px:.1f} px")
    return plot.svg()


def objective_plot(focal_px: Floats, objective: Floats, chosen_focal_px: float | None) -> Markup | None:
    """The paper's objective E over the camera's focal, its minima marked with dots; None where E is finite nowhere."""
    finite = np.isfinite(objective)
    if not finite.any():
        return None
    lowest = max(float(objective[finite].min()), 1e-6)
    highest = min(float(objective[finite].max()), _HIGHEST_OF_LOWEST * lowest)
    plot = Plot(
        Scale(float(focal_px[0]), float(focal_px[-1]), "focal length of the camera (px)", log=True),
        Scale(_ROOM_BELOW**2 * lowest, max(highest, 4 * lowest), "objective E (px)", log=True),
        "the paper's objective over the focal length of the camera",
    )
    for run in np.split(np.arange(len(focal_px)), np.flatnonzero(np.diff(finite)) + 1):
        if finite[run[0]]:
            plot.line(focal_px[run], np.maximum(objective[run], 1e-6))
    for index in local_minima(objective):
        plot.dot(float(focal_px[index]), max(float(objective[index]), 1e-6), f"{focal_px[index]:.0f}")
    if chosen_focal_px is not None and focal_px[0] <= chosen_focal_px <= focal_px[-1]:
        plot.mark_x(chosen_focal_px, f"answer: {chosen_focal_px:.1f} px")
    return plot.svg()


def local_minima(values: Floats) -> list[int]:
    """Indices of the minima of a sampled curve, without its ends; infinite values are undefined."""
    padded = np.where(np.isfinite(values), values, np.inf)
    inner = np.arange(1, len(values) - 1)
    low = (padded[inner] < padded[inner - 1]) & (padded[inner] <= padded[inner + 1])
    return [int(index) for index in inner[low]]


def residual_histogram(
    residuals_px: Sequence[NDArray[np.floating]], noise_px: float | None, limit_px: float, label: str
) -> Markup:
    """Plot histograms of residuals (n,), each sample in its own shade; `noise_px` draws a normal curve."""
    edges = np.linspace(-limit_px, limit_px, _HISTOGRAM_BINS + 1)
    shares = [_shares(residual, edges) for residual in residuals_px]
    curve_px = np.linspace(-limit_px, limit_px, 4 * _HISTOGRAM_BINS)
    curve = 100 * _normal(curve_px, noise_px) * (edges[1] - edges[0]) if noise_px else np.zeros(1)
    highest = 1.08 * max(float(np.max([*map(np.max, shares), curve.max()])), 1e-9)
    plot = Plot(Scale(-limit_px, limit_px, label), Scale(0.0, highest, "% of matches"), f"histogram: {label}")
    for kind, share in zip(("bars", "outline"), shares, strict=False):
        plot.bars(edges, share, kind)
    if noise_px:
        plot.line(curve_px, curve, "second")
    return plot.svg()


def _shares(residual_px: NDArray[np.floating], edges: Floats) -> Floats:
    # With a number of bins instead of their edges, NumPy need not search for each bin.
    counts, _ = np.histogram(residual_px[np.isfinite(residual_px)], len(edges) - 1, (edges[0], edges[-1]))
    return 100 * counts / max(1, int(counts.sum()))


def _normal(x: Floats, sigma: float) -> Floats:
    density: Floats = np.exp(-0.5 * (x / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
    return density
