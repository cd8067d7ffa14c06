"""Contours as a table (CSV), and as a drawing: SVG, and DXF in the result's unit, by ezdxf."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.numerics import Floats
from scanner.measuring.sections import Contour
from scanner.quantities import UNKNOWN_UNIT, shown_unit, unit_name

SECTION_FILES = ("section.csv", "section.svg", "section.dxf")
_WIDTH, _MARGIN, _LINE = 900, 40, 24
_NUMBER = 20.0, 14.0  # width and height of a contour's number
_NAMED = 12  # lengths that a drawing names
_UNITS = {"in": 1, "ft": 2, "mm": 4, "cm": 5, "m": 6}  # $INSUNITS; 0 is none


def write_section_table(path: Path, contours: Sequence[Contour], unit: str) -> None:
    """A line for each contour, the lengths in `unit`. Raises OSError."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("plane", "contour", "points", "closed", "length", "length_sigma", "unit"))
        for number, contour in enumerate(contours, start=1):
            sigma = "" if contour.sigma is None else f"{contour.sigma:.6g}"
            row = (contour.plane.name, number, len(contour.points), int(contour.is_closed), f"{contour.length:.9g}")
            writer.writerow((*row, sigma, unit))


def write_section_svg(path: Path, contours: Sequence[Contour], unit: str) -> None:
    """All contours on one page, seen against the plane's normal, with the lengths of the longest. Raises OSError."""
    every = np.concatenate([contour.points for contour in contours])
    low, extent = every.min(axis=0), np.maximum(np.ptp(every, axis=0), 1e-12)
    scale = (_WIDTH - 2 * _MARGIN) / float(extent.max())
    height = scale * float(extent[1]) + 2 * _MARGIN
    longest = sorted(enumerate(contours, start=1), key=lambda pair: -pair[1].length)[:_NAMED]
    shown = shown_unit(unit)
    numbers: list[tuple[float, float]] = []
    with path.open("w", encoding="utf-8") as file:
        whole = height + _LINE * len(longest)
        file.write(
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {whole:.0f}"><style>text{{font:14px '
            f'system-ui,sans-serif}}path{{fill:none;stroke:#222}}</style><rect width="{_WIDTH}" '
            f'height="{whole:.0f}" fill="#fff"/>\n'
        )
        for number, contour in enumerate(contours, start=1):
            x, y = (scale * (contour.points - low) + _MARGIN).T
            y = height - y
            steps = " L".join(f"{a:.2f} {b:.2f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))
            file.write(f'<path d="M{steps}{" Z" if contour.is_closed else ""}"/>\n')
            if any(number == other for other, _ in longest):
                numbers.append(_free_place(np.stack([x, y], axis=1), numbers))
                across, down = numbers[-1]
                file.write(f'<text x="{across:.1f}" y="{down:.1f}">{number}</text>\n')
        for line, (number, contour) in enumerate(longest, start=1):
            words = f"{number}: {shown.length(contour.length, contour.sigma)} ({contour.plane.name} {unit_name(unit)})"
            file.write(f'<text x="{_MARGIN}" y="{height + _LINE * line - 8:.0f}">{words}</text>\n')
        file.write("</svg>\n")


def _free_place(contour: Floats, others: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """A place (2,) for a number: the point of its contour (N, 2) that is furthest from other numbers, or below it where
    these are as near as that.
    """
    if not others:
        return float(contour[0, 0]), float(contour[0, 1])
    apart = np.linalg.norm(contour[:, None] - np.array(others), axis=2).min(axis=1)
    across, down = contour[np.argmax(apart)].tolist()
    while min(max(abs(across - x) / _NUMBER[0], abs(down - y) / _NUMBER[1]) for x, y in others) < 1:
        down += _NUMBER[1] / 2
    return across, down


def write_section_dxf(path: Path, contours: Sequence[Contour], unit: str) -> None:
    """A layer for each plane, a polyline for each contour, and its length at its beginning. Raises OSError."""
    from ezdxf.filemanagement import new  # which takes long to load

    document = new("R2010", setup=True)
    document.header["$INSUNITS"] = 0 if unit == UNKNOWN_UNIT else _UNITS.get(unit, 0)
    space, shown = document.modelspace(), shown_unit(unit)
    size = 0.02 * float(np.ptp(np.concatenate([contour.points for contour in contours]), axis=0).max())
    for contour in contours:
        layer = contour.plane.name.replace("=", "at").replace(",", " ")
        points = [(float(x), float(y)) for x, y in contour.points.tolist()]
        space.add_lwpolyline(points, close=contour.is_closed, dxfattribs={"layer": layer})
        text = space.add_text(shown.length(contour.length, contour.sigma), height=size, dxfattribs={"layer": "LENGTHS"})
        text.set_placement(points[0])
    document.saveas(path)
