"""The report's plots as inline SVG: curves over the camera's focal length, and histograms of residuals.

They are written directly, and take colours and fonts from the page, in light, in dark and on paper.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor, log10

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from calib.numerics import Floats
from calib.self_calibration import Profile
from scanner.rendering import even_ticks, tick_text

# One unit is one pixel of the narrowest plot, so that the page's font sizes apply.
WIDTH, HEIGHT = 680, 290
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 14, 24, 48
_ACROSS, _DOWN = WIDTH - _LEFT - _RIGHT, HEIGHT - _TOP - _BOTTOM
_MOST_TICKS = 8
_NEAR_THE_RIGHT = 0.8
_HISTOGRAM_BINS = 81
_SIGMAS_SHOWN = 4.0
_HIGHEST_OF_LOWEST = 300.0  # times the lowest objective; larger values are not plotted
_ROOM_BELOW = 0.7


@dataclass(frozen=True)
class Scale:
    """An axis from `low` to `high`, linear or logarithmic, and its label."""

    low: float
    high: float
    label: str
    log: bool = False

    def share(self, values: Floats) -> Floats:
        """Positions along the axis, 0 at its low end and 1 at its high end."""
        if self.log:
            shares: Floats = np.log(values / self.low) / np.log(self.high / self.low)
        else:
            shares = (values - self.low) / (self.high - self.low)
        return shares

    def ticks(self) -> list[float]:
        """Round numbers within the axis."""
        if self.log:
            decades = range(floor(log10(self.low)), ceil(log10(self.high)) + 1)
            for digits in ((1, 2, 5), (1,)):
                ticks = [digit * 10.0**k for k in decades for digit in digits]
                ticks = [value for value in ticks if self.low <= value <= self.high]
                if 3 <= len(ticks) <= _MOST_TICKS:
                    return ticks
        return even_ticks(self.low, self.high, _MOST_TICKS)


class Plot:
    """A plot. Elements are drawn in the order in which they are added, clipped to the axes. Colours are the page's
    classes.
    """

    def __init__(self, x: Scale, y: Scale, alt: str) -> None:
        self._x, self._y, self._alt = x, y, alt
        self._inside: list[str] = []
        self._above: list[str] = []

    def line(self, x: Floats, y: Floats, kind: str = "curve") -> None:
        """A curve through points (n,)."""
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(*self._placed(x, y), strict=True))
        self._inside.append(f'<polyline class="{kind}" points="{points}"/>')

    def bars(self, edges: Floats, heights: Floats, kind: str = "bars") -> None:
        """A histogram: `edges` (n + 1,), `heights` (n,)."""
        x, y = self._placed(np.repeat(edges, 2), np.concatenate([[0.0], np.repeat(heights, 2), [0.0]]))
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
        self._inside.append(f'<polygon class="{kind}" points="{points}"/>')

    def dot(self, x: float, y: float, text: str) -> None:
        """A marked point with its label."""
        (a,), (b,) = self._placed(np.array([x]), np.array([y]))
        self._inside.append(f'<circle class="dot" cx="{a:.1f}" cy="{b:.1f}" r="4.5"/>')
        if text:
            self._above.append(self._text(_LEFT + a, _TOP + min(b + 20, _DOWN - 4), text, "middle"))

    def mark_x(self, x: float, text: str) -> None:
        """A dashed line at a place on the horizontal axis, named above it."""
        (a,), _ = self._placed(np.array([x]), np.array([self._y.high]))
        self._inside.append(f'<line class="mark" x1="{a:.1f}" y1="0" x2="{a:.1f}" y2="{_DOWN}"/>')
        anchor = "end" if a > _NEAR_THE_RIGHT * _ACROSS else "middle"
        self._above.append(self._text(_LEFT + a, _TOP - 8, text, anchor))

    def mark_y(self, y: float, text: str) -> None:
        """A dotted line at a height, named at its right end."""
        _, (b,) = self._placed(np.array([self._x.high]), np.array([y]))
        self._inside.append(f'<line class="level" x1="0" y1="{b:.1f}" x2="{_ACROSS}" y2="{b:.1f}"/>')
        self._above.append(self._text(WIDTH - _RIGHT, _TOP + b - 4, text, "end"))

    def svg(self) -> Markup:
        """The plot as an SVG element."""
        return Markup(
            f'<svg class="plot" role="img" aria-label="{escape(self._alt)}" viewBox="0 0 {WIDTH} {HEIGHT}">'
            + "".join(self._axis_x() + self._axis_y())
            + f'<svg x="{_LEFT}" y="{_TOP}" width="{_ACROSS}" height="{_DOWN}">{"".join(self._inside)}</svg>'
            + "".join(self._above)
            + "</svg>"
        )

    def _placed(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        return _ACROSS * self._x.share(x), _DOWN * (1 - self._y.share(y))

    def _axis_x(self) -> list[str]:
        bottom = _TOP + _DOWN
        parts = [f'<line class="axis" x1="{_LEFT}" y1="{bottom}" x2="{WIDTH - _RIGHT}" y2="{bottom}"/>']
        for tick in self._x.ticks():
            x = _LEFT + _ACROSS * float(self._x.share(np.array([tick]))[0])
            parts.append(f'<line class="grid" x1="{x:.1f}" y1="{_TOP}" x2="{x:.1f}" y2="{bottom}"/>')
            parts.append(self._text(x, bottom + 18, tick_text(tick), "middle"))
        return [*parts, self._text(_LEFT + _ACROSS / 2, HEIGHT - 8, self._x.label, "middle")]

    def _axis_y(self) -> list[str]:
        parts = [f'<line class="axis" x1="{_LEFT}" y1="{_TOP}" x2="{_LEFT}" y2="{_TOP + _DOWN}"/>']
        for tick in self._y.ticks():
            y = _TOP + _DOWN * (1 - float(self._y.share(np.array([tick]))[0]))
            parts.append(f'<line class="grid" x1="{_LEFT}" y1="{y:.1f}" x2="{WIDTH - _RIGHT}" y2="{y:.1f}"/>')
            parts.append(self._text(_LEFT - 7, y + 4.5, tick_text(tick), "end"))
        turned = f'<g transform="translate(16 {_TOP + _DOWN / 2}) rotate(-90)">'
        return [*parts, turned + self._text(0, 0, self._y.label, "middle") + "</g>"]

    @staticmethod
    def _text(x: float, y: float, text: str, anchor: str) -> str:
        return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


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
