"""A floor plan as SVG, inside the page and as a file, and as DXF in the room's unit, by ezdxf."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from markupsafe import Markup, escape

from calib.numerics import Floats
from calib.rooms import Measured
from scanner.quantities import plain, shown_unit
from scanner.rooms.floorplan import FloorPlan, WallLine

_WIDTH, _MARGIN = 900, 90
_STYLE = (
    "text{font:15px system-ui,sans-serif;fill:#222}.wall{stroke:#222;stroke-width:5;stroke-linecap:round}"
    ".thing{stroke:#8a8a8a;stroke-width:2.5;stroke-linecap:round}.ahead{stroke:#0072b2;stroke-width:2}"
    ".camera{fill:#0072b2}.quiet{font-size:13px;fill:#666}.station{fill:#0072b2;font-size:14px}"
)


def plan_svg(plan: FloorPlan, *, standalone: bool = False) -> Markup:
    """The plan; `standalone`: as a file, with its own namespace and a white page."""
    drawing = _Drawing(plan)
    inside = "".join(drawing.parts())
    alone = 'xmlns="http://www.w3.org/2000/svg" ' if standalone else ""
    page = f'<rect width="{_WIDTH}" height="{drawing.height:.0f}" fill="#fff"/>'
    return Markup(
        f'<svg {alone}role="img" aria-label="floor plan" viewBox="0 0 {_WIDTH} {drawing.height:.0f}">'
        f"<style>{_STYLE}</style>{page}{inside}</svg>"
    )


class _Drawing:
    def __init__(self, plan: FloorPlan) -> None:
        self._plan, self._unit = plan, shown_unit(plan.unit)
        ends = [end for line in plan.lines for end in (line.start, line.end)]
        every = np.array([*ends, *plan.cameras])
        self._low, high = every.min(axis=0), every.max(axis=0)
        extent = np.maximum(high - self._low, 1e-9)
        self._scale = (_WIDTH - 2 * _MARGIN) / float(extent[0])
        self.height = 2 * _MARGIN + self._scale * float(extent[1])

    def _at(self, point: Floats) -> tuple[float, float]:
        """Where a point (2,) of the room is on the page: y is up in the room."""
        x, y = (point - self._low) * self._scale
        return _MARGIN + float(x), self.height - _MARGIN - float(y)

    def parts(self) -> Iterator[str]:
        """From below to above."""
        for line in self._plan.lines:
            yield self._segment("wall" if line.is_wall else "thing", line.start, line.end)
        for line in self._plan.lines:
            if line.length is not None:
                yield self._dimension(line, line.length)
        for line in self._plan.lines:
            yield self._number(line)
        for corner in self._plan.corners:
            yield self._angle(corner.position, corner.angle_deg)
        for number, (camera, ahead) in enumerate(zip(self._plan.cameras, self._plan.ahead, strict=True), start=1):
            yield self._segment("ahead", camera, camera + 30 / self._scale * ahead / np.linalg.norm(ahead))
            x, y = self._at(camera)
            yield f'<circle class="camera" cx="{x:.1f}" cy="{y:.1f}" r="6"/>'
            yield self._text(x, y + 22, str(number), "station")
        if self._plan.height is not None:
            height = self._unit.length(self._plan.height.value, self._plan.height.sigma)
            yield self._text(_WIDTH / 2, 24, f"from floor to ceiling {height}", "quiet")

    def _segment(self, kind: str, start: Floats, end: Floats) -> str:
        (x1, y1), (x2, y2) = self._at(start), self._at(end)
        return f'<line class="{kind}" x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"/>'

    def _dimension(self, line: WallLine, length: Measured) -> str:
        """Outside of the wall, along it; never upside down."""
        along = (line.end - line.start) / np.linalg.norm(line.end - line.start)
        outside = np.array([along[1], -along[0]])  # the room is on the left
        x, y = self._at((line.start + line.end) / 2 + 26 / self._scale * outside)
        turn = -float(np.degrees(np.arctan2(along[1], along[0])))
        turn = (turn + 90.001) % 180 - 90.001
        text = escape(self._unit.length(length.value, length.sigma))
        return (
            f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="middle" dominant-baseline="middle" '
            f'transform="rotate({turn:.1f} {x:.1f} {y:.1f})">{text}</text>'
        )

    def _number(self, line: WallLine) -> str:
        """The plane's, beside its middle, towards the room."""
        along = (line.end - line.start) / np.linalg.norm(line.end - line.start)
        inside = np.array([-along[1], along[0]])  # the room is on the left
        x, y = self._at((line.start + line.end) / 2 + 14 / self._scale * inside)
        return self._text(x, y + 4, str(line.plane), "quiet")

    def _angle(self, corner: Floats, angle: Measured) -> str:
        middle = np.mean([end for line in self._plan.lines for end in (line.start, line.end)], axis=0)
        inward = (middle - corner) / max(float(np.linalg.norm(middle - corner)), 1e-9)
        x, y = self._at(corner + 100 / self._scale * inward)
        decimals = max(0, int(np.ceil(-np.log10(max(angle.sigma, 1e-6)))) + 1) if np.isfinite(angle.sigma) else 1
        return self._text(x, y, f"{plain(angle.value, decimals)} ± {plain(angle.sigma, decimals)}°", "quiet")

    @staticmethod
    def _text(x: float, y: float, text: str, kind: str) -> str:
        return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="middle">{escape(text)}</text>'


WALLS, FURNITURE, DIMENSIONS, STATIONS = "WALLS", "FURNITURE", "DIMENSIONS", "STATIONS"
_UNITS = {"in": 1, "ft": 2, "mm": 4, "cm": 5, "m": 6}  # $INSUNITS; 0 is none
_TEXT_OF_SIZE = 0.02


def write_dxf(path: Path, plan: FloorPlan) -> None:
    """Write the plan. Raises OSError."""
    from ezdxf.enums import TextEntityAlignment  # which takes long to load
    from ezdxf.filemanagement import new

    document = new("R2010", setup=True)
    document.header["$INSUNITS"] = _UNITS.get(plan.unit, 0)
    for layer, colour in ((WALLS, 7), (FURNITURE, 8), (DIMENSIONS, 3), (STATIONS, 5)):
        document.layers.add(layer, color=colour)
    space, unit = document.modelspace(), shown_unit(plan.unit)
    ends = np.array([*(end for line in plan.lines for end in (line.start, line.end)), *plan.cameras])
    height = _TEXT_OF_SIZE * max(float(np.ptp(ends, axis=0).max()), 1e-9)

    def text(words: str, at: Floats, layer: str, turn: float = 0.0) -> None:
        entity = space.add_text(words, height=height, rotation=turn, dxfattribs={"layer": layer})
        entity.set_placement((float(at[0]), float(at[1])), align=TextEntityAlignment.MIDDLE_CENTER)

    for line in plan.lines:
        layer = WALLS if line.is_wall else FURNITURE
        start, end = (tuple(point.tolist()) for point in (line.start, line.end))
        space.add_line(start, end, dxfattribs={"layer": layer})
        if line.length is not None:
            along = (line.end - line.start) / np.linalg.norm(line.end - line.start)
            turn = (float(np.degrees(np.arctan2(along[1], along[0]))) + 90.001) % 180 - 90.001
            outside = (line.start + line.end) / 2 + 1.5 * height * np.array([along[1], -along[0]])
            text(unit.length(line.length.value, line.length.sigma), outside, DIMENSIONS, turn)
    for corner in plan.corners:
        inward = ends.mean(axis=0) - corner.position
        angle = f"{plain(corner.angle_deg.value, 3)}° ± {plain(corner.angle_deg.sigma, 3)}°"
        text(angle, corner.position + 4 * height * inward / np.linalg.norm(inward), DIMENSIONS)
    for number, camera in enumerate(plan.cameras, start=1):
        space.add_circle(tuple(camera.tolist()), 0.7 * height, dxfattribs={"layer": STATIONS})
        text(str(number), camera + np.array([0.0, -1.8 * height]), STATIONS)
    document.saveas(path)
