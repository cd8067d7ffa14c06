"""Figures 7 and 8 and the additional curves, on the page."""

from collections.abc import Sequence

import numpy as np

from paper.curves import CURVES
from paper.experiment import Figures
from paper.markdown import NONE, image, mean_of, method_name, number, table
from paper.page_tables import Parts, Pictures
from paper.plots import Axis, curves, heat_maps

_NAMES = {
    "refined": "refined",
    "refined, told so": "refined, told how far off it may be",
    "paper": "the paper's method",
    "bound": "Cramér–Rao bound",
}
_STYLES = {"refined": "s0", "paper": "s1", "refined, told so": "s2", "bound": "bound"}


def figure_7(parts: Parts) -> tuple[str, Pictures]:
    """Errors of the ball in each room, and the maps of the first."""
    rooms = sorted(parts)
    methods = list(parts[rooms[0]]["methods"])
    head = ["", *(f"{room}: MAE, size" for room in rooms), "mean MAE, mm", "mean size error, mm"]
    rows = []
    for method in methods:
        fits = [parts[room]["methods"][method] for room in rooms]
        cells = [_fit(fit) for fit in fits]
        maes = mean_of(fit["mean_absolute_mm"] for fit in fits if fit)
        sizes = mean_of(abs(fit["diameter_error_mm"]) for fit in fits if fit)
        rows.append([method_name(method), *cells, number(maes), number(sizes)])
    first = parts[rooms[0]]["methods"]
    there = {method_name(method): fit for method, fit in first.items() if fit}
    shown = {name: fit["map_um"] for name, fit in there.items()}
    titles = {name: f"MAE {number(fit['mean_absolute_mm'])} mm" for name, fit in there.items()}
    drawn = heat_maps(shown, titles, f"errors of the sphere's fit in {rooms[0]}")
    return table(head, rows), {"figure7.svg": drawn}


def _fit(fit: Figures | None) -> str:
    if fit is None:
        return NONE
    return f"{number(fit['mean_absolute_mm'])}, {number(fit['diameter_error_mm'], signed=True)}"


def figure_8(parts: Parts) -> str:
    """Errors in px of the focal length and the principal point."""
    rows = []
    for room in sorted(parts):
        for photos in ("original", "cropped"):
            figures = parts[room][photos]
            width, height = figures["size"]
            f, x, y = figures["truth_px"]
            about = f"{room}, {photos}, {width} × {height}"
            truth = f"{f:.0f}, ({x:.0f}, {y:.0f})"
            ours = _triple(figures["refined"], f"refused (exit code {figures['exit_code']})")
            sigma = _triple(figures["sigma_px"], signed=False)
            peers = [_triple(figures.get(key)) for key in _peers(parts)]
            rows.append([about, truth, ours, sigma, *peers])
    head = ["", "truth: f, PP", "`scan photos`: f, x₀, y₀ off by", "its σ", *_peers(parts)]
    return table(head, rows)


def _peers(parts: Parts) -> list[str]:
    found = {key for room in parts.values() for key in room["original"] if key.startswith("COLMAP")}
    return sorted(found, reverse=True)


def _triple(errors: Sequence[float] | None, none: str = NONE, *, signed: bool = True) -> str:
    return none if errors is None else ", ".join(number(error, signed=signed) for error in errors)


def beyond(parts: Parts) -> tuple[str, Pictures]:
    """A curve for each varied quantity. Values are in `results/beyond.json`."""
    pictures, texts = {}, []
    for name in (name for name in CURVES if name in parts):
        curve, points = CURVES[name], parts[name]["points"]
        keys = [key for key in _NAMES if any(key in point for point in points)]
        lines = {_NAMES[key]: [(float(point["at"]), point.get(key)) for point in points] for key in keys}
        file = f"beyond-{name.replace(' ', '-')}.svg"
        log = curve.log and min(curve.values) > 0
        styles = {shown: _STYLES[key] for key, shown in _NAMES.items()}
        pictures[file] = curves(Axis(curve.label, log), "median error (%)", lines, f"error over {name}", styles)
        texts.append(f"**Error over {name}.**\n\n{image(f'images/results/{file}', f'error over {name}')}")
    return "\n\n".join(texts), pictures


def ratios_to_bound(parts: Parts) -> list[float]:
    """Median error of the refined method over the bound, at all points with correct prior knowledge."""
    there = [point for name, part in parts.items() if name != "principal point" for point in part["points"]]
    return [float(np.divide(point["refined"], point["bound"])) for point in there if point["refined"] is not None]
