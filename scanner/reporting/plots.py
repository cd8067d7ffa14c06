"""Line plots as inline SVG that takes its colours and fonts from the page, in light and dark."""

import io
import re
from contextlib import AbstractContextManager

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from numpy.typing import NDArray

from calib.arrays import Floats
from calib.selfcalibration import Profile

# Stand-ins that matplotlib accepts; in the SVG they become what the page says.
_INK, _ACCENT, _SECOND = "#010101", "#020202", "#030303"
_PAGE_COLOURS = {_INK: "currentColor", _ACCENT: "var(--accent)", _SECOND: "var(--second)"}
_SIZE_INCHES = (7.6, 3.1)
_NO_METADATA = {"Creator": None, "Date": None, "Format": None, "Type": None}
_HISTOGRAM_BINS = 81
_THREE_SIGMAS_COST = 9.0
_FARTHEST_FOCAL = 3.0  # times the answer: no lens and projector are confused more than that


def _style() -> AbstractContextManager[None]:
    return matplotlib.rc_context(
        {
            "svg.fonttype": "none",
            "svg.hashsalt": "report",
            "font.size": 10.5,
            "text.color": _INK,
            "axes.labelcolor": _INK,
            "axes.edgecolor": _INK,
            "axes.linewidth": 0.6,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "xtick.color": _INK,
            "ytick.color": _INK,
        }
    )


def profile_plot(profile: Profile, chosen_focal_px: float) -> Markup:
    """The cost over the camera's focal length, with the answer marked."""
    with _style():
        figure, axes = _axes()
        apart = np.abs(np.log(profile.focal_px / chosen_focal_px))
        shown = np.isfinite(profile.cost) & (apart <= np.log(_FARTHEST_FOCAL))
        focal, cost = profile.focal_px[shown], profile.cost[shown]
        relative = len(cost) > 0 and cost.min() < 1e-3 * cost.max()
        axes.plot(focal, cost, color=_ACCENT, linewidth=1.8)
        axes.axvline(chosen_focal_px, color=_SECOND, linewidth=1.2, linestyle=(0, (4, 3)))
        axes.annotate(
            f"{chosen_focal_px:.1f} px",
            (chosen_focal_px, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(5, -2),
            textcoords="offset points",
            va="top",
        )
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        if relative:
            axes.set_yscale("symlog", linthresh=1.0)
            axes.set_ylim(bottom=0.0)
            axes.axhline(_THREE_SIGMAS_COST, color=_INK, linewidth=0.6, linestyle=(0, (1, 3)))
            axes.annotate("3 σ", (1.0, _THREE_SIGMAS_COST), xycoords=("axes fraction", "data"), ha="right", va="bottom")
        else:
            axes.set_yscale("log")
        _plain_numbers(axes.xaxis)
        _plain_numbers(axes.yaxis)
        axes.set_xlabel("focal length of the camera (px)")
        axes.set_ylabel(profile.cost_name)
        return _svg(figure, "profile")


def residual_histogram(residual_px: NDArray[np.float32], noise_px: float, limit_px: float) -> Markup:
    """How often the rays miss each other by how much, with the decoder's own spread as a curve."""
    with _style():
        figure, axes = _axes()
        edges = np.linspace(-limit_px, limit_px, _HISTOGRAM_BINS + 1)
        counts, _ = np.histogram(residual_px[np.isfinite(residual_px)], edges)
        share = 100 * counts / max(1, int(counts.sum()))
        axes.stairs(share, edges, fill=True, color=_ACCENT, alpha=0.55, linewidth=0)
        if noise_px > 0:
            fine = np.linspace(-limit_px, limit_px, 20 * _HISTOGRAM_BINS)
            axes.plot(fine, 100 * _normal(fine, noise_px) * (edges[1] - edges[0]), color=_SECOND, linewidth=1.5)
        axes.set_xlabel("miss (px)")
        axes.set_ylabel("% of matches")
        axes.set_xlim(-limit_px, limit_px)
        return _svg(figure, "misses")


def _normal(x: Floats, sigma: float) -> Floats:
    density: Floats = np.exp(-0.5 * (x / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
    return density


def _axes() -> tuple[Figure, Axes]:
    figure = Figure(figsize=_SIZE_INCHES, layout="constrained")
    axes = figure.add_subplot()
    axes.grid(visible=True, color=_INK, alpha=0.12, linewidth=0.6)
    axes.set_axisbelow(True)
    return figure, axes


def _plain_numbers(axis: Axis) -> None:
    """500 rather than 5 × 10²: powers are set too small to read."""
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def _svg(figure: Figure, name: str) -> Markup:
    """The figure as an SVG element with ids of its own, so that several can stand on one page."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", transparent=True, metadata=_NO_METADATA)
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    for unwanted in (
        r"<metadata>.*?</metadata>",
        r"<style.*?</style>",
        r'\sxmlns(:\w+)?="[^"]*"',
        r"font-family: [^;\"]*;? ?",
    ):
        svg = re.sub(unwanted, "", svg, flags=re.DOTALL)
    svg = re.sub(r'(\sid="|url\(#|xlink:href="#)', rf"\1{name}-", svg).replace("xlink:href", "href")
    svg = re.sub(r'<svg width="[^"]*" height="[^"]*"', '<svg class="plot" role="img"', svg)
    for stand_in, colour in _PAGE_COLOURS.items():
        svg = svg.replace(stand_in, colour)
    return Markup(svg)
