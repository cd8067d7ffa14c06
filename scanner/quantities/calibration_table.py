"""The table at the end of a scan: the calibration, how sure of it we are, and how true it is where that is known."""

import numpy as np
from rich import box
from rich.table import Table

from calib.geometry import Calibration
from scanner.quantities.calibration_numbers import (
    Quantity,
    device_quantities,
    intrinsic_errors_percent,
    plain,
    pose_quantities,
)


def calibration_table(calibration: Calibration, truth: Calibration | None = None) -> Table:
    """The calibration with its sigmas, and the truth if it is known."""
    table = empty_table("Calibration", "value", "sigma", *(("truth", "error", "%") if truth else ()))
    devices = [("Camera", device_quantities("camera", calibration, truth))]
    if not calibration.one_camera:
        devices.append(("Projector", device_quantities("projector", calibration, truth)))
    baseline = [quantity for quantity in pose_quantities(calibration, truth) if quantity.name == "baseline"]
    for heading, quantities in (*devices, ("Between them", baseline)):
        table.add_row(heading, style="bold")
        for quantity in quantities:
            name = f"  {quantity.name}" + (f", {quantity.unit}" if quantity.unit else "")
            cells = [name, quantity.shown(quantity.value), _sigma_cell(quantity)]
            table.add_row(*cells, *(_truth_cells(quantity) if truth else ()))
        table.add_section()
    return table


def _sigma_cell(quantity: Quantity) -> str:
    if quantity.sigma is None:
        return ""
    return f"± {quantity.shown(quantity.sigma)}" if quantity.sigma else "given"


def _truth_cells(quantity: Quantity) -> tuple[str, str, str]:
    percent = quantity.error_percent
    return (
        quantity.shown(quantity.truth),
        quantity.shown(quantity.error, signed=True),
        "" if percent is None else plain(percent, 2, signed=True),
    )


def truth_line(calibration: Calibration, truth: Calibration) -> str:
    """State the calibration's errors against the truth, in one line."""
    percent = np.abs(intrinsic_errors_percent(calibration, truth)).mean()
    turned = np.degrees((calibration.pose @ truth.pose.inverse()).angle)
    estimated, true = calibration.pose.translation, truth.pose.translation
    aside = np.degrees(np.arctan2(np.linalg.norm(np.cross(estimated, true)), np.dot(estimated, true)))
    return (
        f"Against the truth: mean absolute error of f_c, f_p, x_p, y_p {percent:.2f} %, "
        f"rotation {turned:.3f}°, direction of the baseline {aside:.3f}°"
    )


def empty_table(title: str, *headings: str) -> Table:
    """A table with a title, a column of names, and right-aligned columns under the headings."""
    table = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE,
        pad_edge=False,
        collapse_padding=True,
        show_header=any(headings),
    )
    table.add_column("", no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table
