"""docs/results.md: all results beside the paper's, with figures 7 and 8. Every number comes from the results."""

from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from paper import published
from paper.colmap import MATCHES
from paper.comparison import where_peers_are_better
from paper.curves import CURVES
from paper.experiment import Results
from paper.markdown import answered, image, mean_of, method_name, number, table
from paper.page_tables import Parts, Pictures, table_1, table_1_both_points, table_1_two_views, table_2, table_3
from paper.photographs import CUT_OFF
from paper.plots import Axis, curves, heat_maps

_NAMES = {
    "refined": "refined",
    "refined, told so": "refined, told how far off it may be",
    "paper": "the paper's method",
    "bound": "Cramér–Rao bound",
}
_STYLES = {"refined": "s0", "paper": "s1", "refined, told so": "s2", "bound": "bound"}
EXPERIMENTS = (
    *("table1", "table1-two-views", "table1-many-views", "table2", "table3"),
    *("figure7", "figure8", "beyond"),
)
_OF_COLMAP = "-views"
_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent), undefined=StrictUndefined, trim_blocks=True, autoescape=False
)


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


def write_page(page: Path, images: Path, results: Results) -> None:
    """Write the page and its pictures; missing results are named. Raises OSError."""
    text, pictures = render(results)
    images.mkdir(parents=True, exist_ok=True)
    for name, svg in pictures.items():
        (images / name).write_text(svg, encoding="utf-8")
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(text, encoding="utf-8")


def render(results: Results) -> tuple[str, Pictures]:
    """The page as Markdown, and its pictures by file name. Raises ValueError without results."""
    parts = {name: results.read(name) for name in EXPERIMENTS}
    absent = [name for name, found in parts.items() if not found]
    if len(absent) == len(EXPERIMENTS):
        raise ValueError(f"{results.folder} holds no results; measure something first")
    made = [results.made_with(name) for name in EXPERIMENTS if name not in absent]
    versions = {package: version for each in made for package, version in each["versions"].items()}
    rooms = {part.removeprefix("room ") for found in parts.values() for part in found if part.startswith("room")}
    pictures: Pictures = {}
    context = _context(parts, pictures)
    text = _TEMPLATES.get_template("results.md.jinja").render(
        context,
        made=made[0],
        rooms=sorted(rooms),
        versions=[f"{package} {version}" for package, version in versions.items()],
        absent=absent,
        colmap_absent=any(_OF_COLMAP in name for name in absent),
        better=where_peers_are_better(results),
    )
    return text.rstrip() + "\n", pictures


def _context(parts: dict[str, Parts], pictures: Pictures) -> dict[str, Any]:
    """Values of the template for each experiment; adds to the pictures."""
    own, many_views = parts["table1"], parts["table1-many-views"]
    context: dict[str, Any] = {
        "table_1": table_1(own, many_views) if own else "",
        "two_views": table_1_two_views(parts["table1-two-views"]) if parts["table1-two-views"] else "",
        "both_points": table_1_both_points(parts["table1-two-views"]) if parts["table1-two-views"] else "",
        "views": next(iter(many_views.values()), None),
        "colmap_matches": MATCHES,
        "start": [number(100 * share) for share in published.RANDOM_START_SHORT_BY],
        "all_matches": published.MATCHES,
        "ball_mm": published.SPHERE_MM,
        "cut_off": [f"{100 * share:g}" for share in CUT_OFF],
        "figure_8": figure_8(parts["figure8"]) if parts["figure8"] else "",
    }
    for key, name, write in (
        ("table_2", "table2", table_2),
        ("table_3", "table3", table_3),
        ("figure_7", "figure7", figure_7),
        ("beyond", "beyond", beyond),
    ):
        context[key], drawn = write(parts[name]) if parts[name] else ("", {})
        pictures |= drawn
    if curves := parts["beyond"]:
        context["to_bound"] = f"{np.median(ratios_to_bound(curves)):.2f}"
        context["corners"] = next(iter(curves.values()))["points"][0]["corners"]
    return context
