"""docs/results.md: all results beside the paper's. Every number comes from the results."""

from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from paper import published
from paper.comparison import where_peers_are_better
from paper.experiment import Results
from paper.markdown import number
from paper.page_figures import beyond, figure_7, figure_8, ratios_to_bound
from paper.page_tables import Parts, Pictures, table_1, table_1_both_points, table_1_two_views, table_2, table_3
from paper.photographs import CUT_OFF
from paper.two_views import MATCHES

EXPERIMENTS = (
    *("table1", "table1-two-views", "table1-many-views", "table2", "table3"),
    *("figure7", "figure8", "beyond"),
)
_OF_COLMAP = "-views"
_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent), undefined=StrictUndefined, trim_blocks=True, autoescape=False
)


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
