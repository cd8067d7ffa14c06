"""A floor plan as DXF, by ezdxf: walls, furniture, lengths and stations on separate layers, in the room's unit."""

from pathlib import Path

import numpy as np
from ezdxf.enums import TextEntityAlignment
from ezdxf.filemanagement import new

from calib.numerics import Floats
from scanner.quantities import plain, shown_unit
from scanner.rooms.floorplan import FloorPlan

WALLS, FURNITURE, DIMENSIONS, STATIONS = "WALLS", "FURNITURE", "DIMENSIONS", "STATIONS"
_UNITS = {"in": 1, "ft": 2, "mm": 4, "cm": 5, "m": 6}  # $INSUNITS; 0 is none
_TEXT_OF_SIZE = 0.02


def write_dxf(path: Path, plan: FloorPlan) -> None:
    """Write the plan. Raises OSError."""
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
