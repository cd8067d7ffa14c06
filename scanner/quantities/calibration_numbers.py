"""The numbers of a calibration, each with its sigma, and with the truth where that is known; and the table of them at
the end of a scan.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import atan2, degrees, floor, log10
from typing import Literal

import numpy as np
from rich import box
from rich.table import Table

from calib.geometry import Calibration, DeviceSigmas, Intrinsics
from calib.numerics import Floats

FACE_NAMES = ("A", "B", "C")


def device_names(calibration: Calibration, number: int = 1, among: int = 1) -> tuple[str, str]:
    """Return the names of both devices of capture `number` (from 1, the oldest) of `among`. Pairs of photos have one
    camera.

    Every pair of photos includes the first; the newest pair is the one with the second.
    """
    if calibration.one_camera:
        return "photo 1", f"photo {among - number + 2}"
    which = f" {number}" if among > 1 else ""
    return f"camera{which}", f"projector{which}"


_DISTORTION_NAMES = ("k₁", "k₂", "p₁", "p₂", "k₃")
_DEFAULT_SIGNIFICANT = 5


@dataclass(frozen=True)
class Quantity:
    """One number. `sigma` (0: fixed) and `truth` are None where unknown; `meaning` explains it briefly."""

    name: str
    value: float
    unit: str = ""
    sigma: float | None = None
    truth: float | None = None
    meaning: str = ""

    @property
    def decimals(self) -> int:
        """Number of decimals for two digits of sigma, or five significant digits without a sigma."""
        if self.sigma:
            return max(0, 1 - floor(log10(self.sigma)))
        size = max(abs(self.value), 1.0 if self.unit else 1e-4)
        return int(np.clip(_DEFAULT_SIGNIFICANT - 1 - floor(log10(size)), 0, 5))

    def shown(self, value: float | None, *, signed: bool = False) -> str:
        """A value of this quantity with its number of decimals; '' for None."""
        return "" if value is None else plain(value, self.decimals, signed=signed)

    @property
    def error(self) -> float | None:
        """Value minus truth."""
        return None if self.truth is None else self.value - self.truth

    @property
    def error_percent(self) -> float | None:
        """Error relative to the truth; only for lengths, where it means something."""
        if self.error is None or not self.truth or self.unit != "px":
            return None
        return 100 * self.error / abs(self.truth)

    @property
    def error_sigmas(self) -> float | None:
        """Error in units of sigma."""
        return self.error / self.sigma if self.error is not None and self.sigma else None


def plain(value: float, decimals: int, *, signed: bool = False) -> str:
    """Format a number with a typographic minus sign, and without a sign if it is shown as zero."""
    text = f"{value:z.{decimals}f}"
    sign = "+" if signed and value > 0 and float(text) else ""
    return f"{sign}{text}".replace("-", "−")


def percent(share: float) -> str:
    """Format a share: a nonzero one is never 0 %, and one below 1 never 100 %."""
    value = 100 * share
    if 0 < value < 0.1:
        return "< 0.1 %"
    return "> 99.9 %" if 99.9 < value < 100 else f"{value:.1f} %"


def device_quantities(
    name: Literal["camera", "projector"], calibration: Calibration, truth: Calibration | None
) -> list[Quantity]:
    """Intrinsics of one device."""
    device = calibration.camera if name == "camera" else calibration.projector
    sigmas = calibration.sigma.camera if name == "camera" else calibration.sigma.projector
    true = None if truth is None else truth.camera if name == "camera" else truth.projector
    return [
        *_focal_lengths(device, true, sigmas, throws=name == "projector"),
        *_principal_point(device, true, sigmas),
        *_distortion(device, true, sigmas),
    ]


def _focal_lengths(
    device: Intrinsics, true: Intrinsics | None, sigmas: DeviceSigmas, *, throws: bool
) -> Iterator[Quantity]:
    square = device.focal_px[0] == device.focal_px[1]
    for axis, label in enumerate(("",) if square else (", x", ", y")):
        length, side = device.focal_px[axis], (device.width, device.height)[axis]
        yield Quantity(
            f"focal length{label}",
            length,
            "px",
            _at(sigmas.focal_px, axis),
            true.focal_px[axis] if true else None,
            f"field of view {2 * degrees(atan2(side / 2, length)):.0f}°"
            + (f", throw ratio {length / side:.2f}" if throws and axis == 0 else ""),
        )


def _principal_point(device: Intrinsics, true: Intrinsics | None, sigmas: DeviceSigmas) -> Iterator[Quantity]:
    for axis, label in enumerate(("x₀", "y₀")):
        yield Quantity(
            f"principal point {label}",
            device.principal_point_px[axis],
            "px",
            _at(sigmas.principal_point_px, axis),
            true.principal_point_px[axis] if true else None,
            f"image centre {((device.width, device.height)[axis] - 1) / 2:g}",
        )


def _distortion(device: Intrinsics, true: Intrinsics | None, sigmas: DeviceSigmas) -> Iterator[Quantity]:
    for index, label in enumerate(_DISTORTION_NAMES):
        value, true_value = device.distortion[index], true.distortion[index] if true else None
        if value or true_value:
            meaning = "radial lens distortion, OpenCV's model" if index == 0 else ""
            yield Quantity(f"distortion {label}", value, "", _at(sigmas.distortion, index), true_value, meaning)


def pose_quantities(calibration: Calibration, truth: Calibration | None) -> list[Quantity]:
    """Return the relative pose of the two devices; lengths are compared only with a truth of the same unit."""
    same_unit = truth is not None and truth.unit == calibration.unit
    first, second = device_names(calibration)
    quantities = [
        Quantity(
            "baseline",
            calibration.baseline,
            "" if calibration.unit == "baseline" else calibration.unit,
            calibration.sigma.known_baseline,
            truth.baseline if truth is not None and same_unit else None,
            "unit of all lengths" if calibration.unit == "baseline" else f"distance between {first} and {second}",
        ),
        Quantity(
            "turned by",
            degrees(calibration.pose.angle),
            "°",
            None,
            degrees(truth.pose.angle) if truth else None,
            f"angle of the rotation from the {first} to the {second}",
        ),
    ]
    if truth is not None:
        error = calibration.pose @ truth.pose.inverse()
        quantities.append(
            Quantity("rotation error", degrees(error.angle), "°", meaning="between the rotation and the true one")
        )
    return quantities


def relative_focal_sigmas(calibration: Calibration) -> dict[str, float]:
    """Return the relative sigma of each device's focal length, the larger of two axes; unknown ones are omitted."""
    devices = {
        "camera": (calibration.camera, calibration.sigma.camera),
        "projector": (calibration.projector, calibration.sigma.projector),
    }
    return {
        name: max(sigmas.focal_px) / device.focal_px[0] for name, (device, sigmas) in devices.items() if sigmas.focal_px
    }


def intrinsic_errors_percent(calibration: Calibration, truth: Calibration) -> Floats:
    """Relative errors of f_c, f_p, x_p and y_p, (4,), in per cent of the truth: those that the paper reports."""

    def four(of: Calibration) -> Floats:
        return np.array([np.mean(of.camera.focal_px), np.mean(of.projector.focal_px), *of.projector.principal_point_px])

    return 100 * (four(calibration) / four(truth) - 1)


def _at(sigmas: tuple[float, ...] | None, index: int) -> float | None:
    return sigmas[index] if sigmas and index < len(sigmas) else None


def rig_quantities(calibration: Calibration) -> list[tuple[str, list[Quantity]]]:
    """All of a calibration that has no truth, as tables with a heading each."""
    return [
        ("Camera", device_quantities("camera", calibration, None)),
        ("Projector", device_quantities("projector", calibration, None)),
        ("Between them", pose_quantities(calibration, None)),
    ]


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
