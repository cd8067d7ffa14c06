"""A check as a folder: `check.yaml` with the rows, and pictures of the findings, in colours that are distinguishable
with any colour vision.
"""

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import yaml

from calib.numerics import Bools, Floats
from scanner.checking.fringes import FringePower, cell_size, smoothed
from scanner.checking.light import Light
from scanner.checking.report import CheckReport, Pixels
from scanner.io import write_png
from scanner.patterns import FORMAT, Axis
from scanner.rendering import BLUE, ORANGE, SKY_BLUE, VERMILION, VIRIDIS, photograph, shaded
from scanner.results import OutputFolder

_OPACITY = 0.45
_LEGEND_PX = 34
_TEXT_SCALE = 0.5
_UNKNOWN = 0
_LONGEST_SIDE_PX = 1000
_LEAST_WIDTH_PX = 800
CHECK_FILE = "check.yaml"


def saturation_picture(light: Light) -> Pixels:
    """The white frame; clipped pixels in vermilion, those without the projector's light in blue."""
    picture = _grey_picture(light)
    picture = _tinted(picture, _reduced(~light.lit, picture), BLUE)
    picture = _tinted(picture, _reduced(light.clipped, picture), VERMILION, 1.0)
    return _with_legend(picture, ((BLUE, "no light of the projector"), (VERMILION, "clipped")))


def coverage_picture(light: Light, matched: Bools) -> Pixels:
    """The white frame; pixels that a quick capture matches in sky blue, lit ones without a match in orange."""
    picture = _grey_picture(light)
    picture = _tinted(picture, _reduced(matched, picture), SKY_BLUE)
    picture = _tinted(picture, _reduced(light.lit & ~matched, picture), ORANGE)
    return _with_legend(picture, ((SKY_BLUE, "matched"), (ORANGE, "bright, without a match")))


def contrast_picture(fringes: Mapping[tuple[Axis, float], FringePower], usable: Bools) -> Pixels:
    """How much of the finest stripes is left relative to the longest, dark for 0 and bright for all; black: unknown."""
    size = cell_size(usable.shape)
    ratios = [_ratio(fringes, axis, usable, size) for axis in ("x", "y")]
    remaining = np.minimum(*ratios)
    colours = shaded(np.clip(np.nan_to_num(remaining), 0, 1), VIRIDIS)
    picture = np.where(np.isfinite(remaining)[..., None], colours, np.uint8(_UNKNOWN))
    factor = max(1.0, max(usable.shape) / _LONGEST_SIDE_PX)
    size_px = (round(usable.shape[1] / factor), round(usable.shape[0] / factor))
    picture = np.asarray(cv2.resize(picture, size_px, interpolation=cv2.INTER_NEAREST), np.uint8)
    periods = sorted({period for _, period in fringes})
    text = f"left of stripes of {periods[0]:g} px, relative to {periods[-1]:g} px; the fainter of two directions"
    return _with_scale(picture, text)


def _ratio(fringes: Mapping[tuple[Axis, float], FringePower], axis: Axis, usable: Bools, size: int) -> Floats:
    periods = sorted(period for direction, period in fringes if direction == axis)
    weight = usable.astype(np.float64)
    short, long = (fringes[axis, period] for period in (periods[0], periods[-1]))
    over = smoothed((short.power - short.noise) * weight, size)
    under = smoothed((long.power - long.noise) * weight, size)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio: Floats = np.sqrt(np.maximum(over, 0.0) / under)
    return np.where(usable & (under > 0), ratio, np.nan)


def write_pictures(folder: Path, pictures: Mapping[str, Pixels]) -> list[str]:
    """`<name>.png` for each; their names. Raises OSError."""
    for name, picture in pictures.items():
        write_png(folder / f"{name}.png", np.ascontiguousarray(picture[..., ::-1]))
    return [f"{name}.png" for name in pictures]


def _grey_picture(light: Light) -> Pixels:
    picture = photograph(np.clip(light.mean_white / light.highest * 255, 0, 255).astype(np.uint8))
    return np.repeat(picture.mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8)


def _reduced(mask: Bools, picture: Pixels) -> Bools:
    height, width = picture.shape[:2]
    share = cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(share) > 0.5


def _tinted(picture: Pixels, where: Bools, colour: tuple[int, int, int], opacity: float = _OPACITY) -> Pixels:
    mixed = (1 - opacity) * picture + opacity * np.array(colour)
    return np.where(where[..., None], mixed, picture).astype(np.uint8)


def _with_legend(picture: Pixels, entries: tuple[tuple[tuple[int, int, int], str], ...]) -> Pixels:
    picture = _enlarged(picture)
    legend = np.full((_LEGEND_PX, picture.shape[1], 3), 255, np.uint8)
    x = 10
    for colour, text in entries:
        legend[10:26, x : x + 16] = colour
        x = _write(legend, text, x + 24) + 24
    return np.concatenate([picture, legend])


def _enlarged(picture: Pixels) -> Pixels:
    """Enlarge by an integer factor, to make room for the legend below."""
    factor = -(-_LEAST_WIDTH_PX // picture.shape[1])
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def _with_scale(picture: Pixels, text: str) -> Pixels:
    picture = _enlarged(picture)
    legend = np.full((_LEGEND_PX, picture.shape[1], 3), 255, np.uint8)
    bar = shaded(np.linspace(0, 1, 120), VIRIDIS)
    x = _write(legend, "0 %", 10) + 6
    legend[10:26, x : x + 120] = bar[: max(0, legend.shape[1] - x)]
    x = _write(legend, "100 %", x + 128)
    _write(legend, text, x + 16)
    return np.concatenate([picture, legend])


def _write(image: Pixels, text: str, x: int) -> int:
    """Put black text into an image; where it ends."""
    cv2.putText(image, text, (x, 23), cv2.FONT_HERSHEY_SIMPLEX, _TEXT_SCALE, (0, 0, 0), 1, cv2.LINE_AA)
    (width, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, _TEXT_SCALE, 1)
    return x + int(width)


def write_check(out: Path, report: CheckReport) -> None:
    """Write the folder, whole or not at all. Raises InputError if it exists."""
    with OutputFolder(out) as output:
        document = {
            "format": FORMAT,
            "state": report.state.value,
            "exposure_us": report.exposure_us,
            "response": None if report.response is None else list(report.response),
            "rows": [
                {
                    "name": row.name,
                    "kind": row.finding.kind.name,
                    "state": row.state.value,
                    "finding": row.finding.message,
                    "advice": row.finding.advice,
                }
                for row in report.rows
            ],
            "pictures": write_pictures(output.folder, report.pictures),
        }
        text = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=120)
        (output.folder / CHECK_FILE).write_text(text, encoding="utf-8")
