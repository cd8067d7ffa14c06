"""Figures 7 and 8 and the additional curves, on the page."""

import numpy as np

from paper.curves import CURVES
from paper.markdown import answered, image, mean_of, method_name, number, table
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
    """Errors of the ball, means over the rooms, and the maps of the first."""
    rooms = sorted(parts)
    methods = list(parts[rooms[0]]["methods"])
    rows = []
    for method in methods:
        fits = [parts[room]["methods"][method] for room in rooms]
        maes = mean_of(fit["mean_absolute_mm"] for fit in fits if fit)
        sizes = mean_of(abs(fit["diameter_error_mm"]) for fit in fits if fit)
        rows.append([method_name(method) + answered(fits), number(maes), number(sizes)])
    first = parts[rooms[0]]["methods"]
    there = {method_name(method): fit for method, fit in first.items() if fit}
    shown = {name: fit["map_um"] for name, fit in there.items()}
    titles = {name: f"MAE {number(fit['mean_absolute_mm'])} mm" for name, fit in there.items()}
    drawn = heat_maps(shown, titles, f"errors of the sphere's fit in {rooms[0]}")
    return table(["", "MAE, mm", "size, mm"], rows), {"figure7.svg": drawn}


def figure_8(parts: Parts) -> str:
    """Mean absolute errors in px of the focal length and the principal point."""
    photos = [parts[room][kind] for room in sorted(parts) for kind in ("original", "cropped")]
    keys = {"refined": "`scan photos`", "sigma_px": "its σ", **{peer: peer for peer in _peers(parts)}}
    rows = []
    for key, shown in keys.items():
        errors = [figures.get(key) for figures in photos]
        each = [mean_of(None if three is None else abs(three[i]) for three in errors) for i in range(3)]
        rows.append([shown + answered(errors), *map(number, each)])
    return table(["", "f", "x₀", "y₀"], rows)


def _peers(parts: Parts) -> list[str]:
    found = {key for room in parts.values() for key in room["original"] if key.startswith("COLMAP")}
    return sorted(found, reverse=True)


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
        texts.append(image(f"images/results/{file}", f"error over {name}"))
    return "\n\n".join(texts), pictures


def ratios_to_bound(parts: Parts) -> list[float]:
    """Median error of the refined method over the bound, at all points with correct prior knowledge."""
    there = [point for name, part in parts.items() if name != "principal point" for point in part["points"]]
    return [float(np.divide(point["refined"], point["bound"])) for point in there if point["refined"] is not None]
