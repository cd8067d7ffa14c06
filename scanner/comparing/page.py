"""A comparison as compare.html, with maps over the camera's picture, and as compare.json."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from calib.geometry import Size
from calib.numerics import Floats
from scanner.comparing.comparison import CalibrationComparison, Sheet
from scanner.comparing.summary import PX, comparison_verdict, headings, rows
from scanner.quantities import ShownUnit, shown_unit
from scanner.rendering import VIRIDIS, ColourScale, css_colour, page, shaded

COMPARE_FILE, COMPARE_PAGE = "compare.json", "compare.html"
_FORMAT = 1
_SHADES = tuple(css_colour((int(r), int(g), int(b))) for r, g, b in VIRIDIS[::16])


@dataclass(frozen=True)
class _Map:
    """A picture with its scale and what is under it."""

    plot: Markup
    scale: ColourScale
    caption: str


def write_compare_page(path: Path, comparison: CalibrationComparison) -> None:
    """Write the page; it needs no network and no other file. Raises OSError."""
    text = page(
        "compare.html",
        names=comparison.names,
        verdict=comparison_verdict(comparison),
        headings=headings(comparison),
        rows=rows(comparison),
        maps=[
            (shown_unit(comparison.unit).length(sheet.depth), list(_maps(comparison, sheet)))
            for sheet in comparison.sheets
        ],
    )
    path.write_text(text, encoding="utf-8")


def _maps(comparison: CalibrationComparison, sheet: Sheet) -> Iterator[_Map]:
    if np.isnan(sheet.length).all():
        return
    unit, known = shown_unit(comparison.unit), any(comparison.known)
    what = [(PX, sheet.px), (unit, sheet.length)]
    if known:
        what.append((ShownUnit(1.0, "standard deviations"), sheet.length / sheet.length_sigma))
    for shown, values in what:
        largest = float(np.nanmax(values))
        plot = _heat(shown.factor * values, comparison.camera_size, f"difference in {shown.name} over the picture")
        yield _Map(plot, ColourScale(_SHADES, "0", shown.error(largest)), f"Difference in {shown.name}")


def _heat(values: Floats, size: Size, label: str) -> Markup:
    """A picture (H, W) of squares over the camera's, dark at zero and bright at the largest value."""
    height, width = values.shape
    across, down = size.width / width, size.height / height
    largest = float(np.nanmax(values)) or 1.0
    squares = []
    for row, column in zip(*np.nonzero(np.isfinite(values)), strict=True):
        value = float(values[row, column])
        red, green, blue = (int(channel) for channel in shaded(np.array(value / largest), VIRIDIS))
        squares.append(
            f'<rect x="{column * across:.1f}" y="{row * down:.1f}" width="{across:.1f}" height="{down:.1f}" '
            f'fill="{css_colour((red, green, blue))}"><title>{value:.3g}</title></rect>'
        )
    return Markup(
        f'<svg class="plot" style="min-width:0" role="img" aria-label="{escape(label)}" '
        f'viewBox="0 0 {size.width} {size.height}">{"".join(squares)}<rect width="{size.width}" '
        f'height="{size.height}" fill="none" stroke="currentColor" stroke-width="{max(size) / 300:.1f}"/></svg>'
    )


def write_compare(path: Path, comparison: CalibrationComparison) -> None:
    """Write all numbers; lengths are in `unit`, null where not both devices see. Raises OSError."""
    path.write_text(json.dumps(_document(comparison), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _document(comparison: CalibrationComparison) -> dict[str, Any]:
    difference = comparison.difference
    return {
        "format": _FORMAT,
        "calibrations": list(comparison.names),
        "covariance_known": list(comparison.known),
        "unit": comparison.unit,
        "second_enlarged_by": difference.scale,
        "agree": difference.agree if any(comparison.known) else None,
        "chi2": difference.chi2,
        "freedom": difference.freedom,
        "limit": difference.limit,
        "unexplained": difference.unexplained,
        "verdict": comparison_verdict(comparison).headline,
        "camera_px": comparison.camera_px.round(3).tolist(),
        "depths": [
            {
                "depth": sheet.depth,
                "length": _numbers(sheet.length),
                "length_sigma": _numbers(sheet.length_sigma),
                "projector_px": _numbers(sheet.px),
                "projector_px_sigma": _numbers(sheet.px_sigma),
            }
            for sheet in comparison.sheets
        ],
    }


def _numbers(values: Floats) -> list[list[float | None]]:
    return [[float(f"{value:.6g}") if np.isfinite(value) else None for value in row] for row in values]
