"""`measure.png`: heat maps of the fitting errors, over the camera's pixels."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calib.numerics import Floats
from calib.pointcloud import NONE, index_grid, without_gaps
from scanner.measuring.measurements import FitErrors, Measurements
from scanner.quantities import ShownUnit, shown_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIGURE_FILE = "measure.png"

_PANEL_INCHES = (6.4, 5.2)
_DPI = 110
_FONT_POINTS = 10
_SHOWN_SHARE = 0.99
_COLOURS = "coolwarm"
_NO_POINT = "#d9d9d9"
_MARGIN_OF_IMAGE = 0.15


def write_figure(path: Path, measured: Measurements) -> None:
    """Draw a panel for each sphere and one for all faces; there has to be one of either. Raises OSError."""
    # Loading matplotlib takes longer than some whole commands, none of which draws with it but this one.
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    panels = len(measured.spheres) + bool(measured.faces)
    unit = shown_unit(measured.unit)
    figure = Figure(figsize=(panels * _PANEL_INCHES[0], _PANEL_INCHES[1]), dpi=_DPI, layout="constrained")
    every = figure.subplots(1, panels, squeeze=False)[0]
    for number, (sphere, axes) in enumerate(zip(measured.spheres, every, strict=False), start=1):
        _draw(axes, [sphere.errors], unit)
        x, y, radius = sphere.image_px
        axes.add_patch(Circle((x, y), radius, fill=False, linestyle="--", linewidth=0.8))
        reach = (1 + _MARGIN_OF_IMAGE) * radius
        axes.set_xlim(x - reach, x + reach)
        axes.set_ylim(y + reach, y - reach)
        fitted = f"diameter {unit.length(sphere.diameter, sphere.diameter_sigma)}"
        _title(axes, f"Sphere {number}: {fitted}", f"mean absolute error {unit.error(sphere.errors.mean_absolute)}")
    if measured.faces:
        _draw(every[-1], [face.errors for face in measured.faces], unit)
        flatness = ", ".join(f"{face.name} {unit.number(face.errors.mean_absolute)}" for face in measured.faces)
        _title(every[-1], "Flatness of the faces: mean absolute errors", f"{flatness} {unit.name}")
    figure.savefig(path, format="png", metadata={"Software": None})


def _draw(axes: "Axes", errors: Sequence[FitErrors], unit: ShownUnit) -> None:
    """Signed distances in colour, on the part of the camera's image that has them."""
    residual = unit.factor * np.concatenate([part.residual for part in errors])
    pixel = np.concatenate([part.pixel for part in errors])
    (left, top), (right, bottom) = pixel.min(axis=0), pixel.max(axis=0)
    index = without_gaps(index_grid(pixel - (left, top), (right - left + 1, bottom - top + 1)))
    grid: Floats = np.where(index == NONE, np.nan, residual[index])
    limit = float(np.quantile(np.abs(residual), _SHOWN_SHARE)) or 1.0
    extent = (left - 0.5, right + 0.5, bottom + 0.5, top - 0.5)
    picture = axes.imshow(grid, cmap=_COLOURS, vmin=-limit, vmax=limit, extent=extent, interpolation="nearest")
    axes.set_facecolor(_NO_POINT)
    bar = axes.figure.colorbar(picture, ax=axes, extend="both", shrink=0.9)
    bar.set_label(f"{unit.name} off, + towards the camera", size=_FONT_POINTS)
    bar.ax.tick_params(labelsize=_FONT_POINTS)
    axes.set_xlabel("camera column, px", size=_FONT_POINTS)
    axes.set_ylabel("camera row, px", size=_FONT_POINTS)
    axes.tick_params(labelsize=_FONT_POINTS)


def _title(axes: "Axes", first: str, second: str) -> None:
    axes.set_title(f"{first}\n{second}", fontsize=_FONT_POINTS + 1)
