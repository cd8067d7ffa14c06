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
from scanner.comparing.summary import headings, rows, summary
from scanner.quantities import shown_unit
from scanner.rendering import VIRIDIS, css_colour, page, shaded

COMPARE_FILE, COMPARE_PAGE = "compare.json", "compare.html"
_FORMAT = 1


@dataclass(frozen=True)
class _Map:
    """A picture with the sentence under it."""

    plot: Markup
    caption: str


def write_compare_page(path: Path, comparison: CalibrationComparison) -> None:
    """Write the page; it needs no network and no other file. Raises OSError."""
    verdict, *sentences = summary(comparison)
    text = page(
        "compare.html",
        names=comparison.names,
        verdict=verdict,
        sentences=sentences,
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
    what = [("projector px", sheet.px, 1.0), (unit.name, sheet.length, unit.factor)]
    if known:
        what.append(("sigmas", sheet.length / sheet.length_sigma, 1.0))
    for name, values, factor in what:
        largest = float(np.nanmax(values)) * factor
        plot = _heat(values * factor, comparison.camera_size, f"difference in {name} over the camera's picture")
        yield _Map(plot, f"Difference in {name}: dark is 0, bright is {largest:.3g}.")


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
        "verdict": next(summary(comparison)),
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
