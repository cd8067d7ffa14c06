"""Diagrams of what is scanned, and of the estimate that follows: a corner, a room, a thing, a network."""

from collections.abc import Sequence
from math import cos, radians, sin

from diagrams.drawing import Drawing, Point

_FLOW_LEFT, _FLOW_WIDTH = 450.0, 294.0


def corner() -> Drawing:
    """The three faces, both devices, and the way to a calibration."""
    drawing = Drawing(
        *(760, 460),
        "Self-calibration from a corner",
        "A projector lights two walls and the floor, a camera sees them. Matches on the three planes give "
        "homographies, those a corner in closed form for each focal length, and maximum likelihood the "
        "calibration.",
    )
    vertex, top, left, right, front = (215.0, 200.0), (215.0, 24.0), (40.0, 270.0), (390.0, 270.0), (215.0, 360.0)
    drawing.area([top, vertex, left, (40, 84)], "c")
    drawing.area([top, vertex, right, (390, 84)], "c")
    drawing.area([vertex, left, front, right], "c")
    camera, projector = (320.0, 410.0), (110.0, 410.0)
    for x, y in ((120.0, 150.0), (310.0, 170.0), (180.0, 300.0)):
        drawing.line([projector, (x, y)], "b-line")
        drawing.line([(x, y), camera], "a-line")
        drawing.circle((x, y), 4, "box")
    drawing.box(projector[0] - 46, projector[1], 92, 34, ["projector"], "b")
    drawing.box(camera[0] - 40, camera[1], 80, 34, ["camera"], "a")
    for at, face in (((60, 120), "face A"), ((330, 120), "face B"), ((252, 264), "face C")):
        drawing.text(*at, face, "bold")
    _flow(
        drawing,
        20,
        [
            (["Matches", "camera pixel, projector pixel, sigma"], "a"),
            (["Faces", "three planes, three homographies"], "box"),
            (["Closed form for each focal length", "corner, projector, relative pose"], "box"),
            (["Maximum likelihood", "lenses, noise, priors, further planes"], "box"),
            (["Profile along the focal length", "every minimum, the whole valley"], "box"),
            (["Calibration with covariance", "or a refusal with its reason"], "c"),
        ],
    )
    return drawing


def room() -> Drawing:
    """Stations that overlap, and their joint estimate."""
    drawing = Drawing(
        *(760, 440),
        "Stations of a room",
        "Five stations of one rig see overlapping parts of a room. Pairs are registered, all loops decide "
        "together, and one estimate gives rig, poses and planes.",
    )
    drawing.area([(24, 24), (420, 24), (420, 370), (24, 370)], "box")
    for x, y, width, height in ((24, 24, 120, 40), (330, 300, 90, 70), (24, 200, 36, 90)):
        drawing.area([(x, y), (x + width, y), (x + width, y + height), (x, y + height)], "c")
    stations = [(_around((222.0, 197.0), -45, looks), looks) for looks in range(-100, 260, 72)]
    for place, looks in stations:
        drawing.area([place, *(_to_wall(place, looks + side) for side in range(-42, 43, 4))], "a")
    for number, (place, _) in enumerate(stations, 1):
        drawing.circle(place, 12, "box")
        drawing.text(place[0], place[1] + 5, f"{number}", "bold", "middle")
    drawing.text(222, 394, "walls, furniture and five stations", "quiet", "middle")
    drawing.text(222, 412, "of one unchanged rig", "quiet", "middle")
    _flow(
        drawing,
        20,
        [
            (["Corner of one station", "first calibration of the rig"], "a"),
            (["Pairs of stations", "planes, features, free space"], "box"),
            (["All pairs and loops", "wrong pairs are outvoted"], "box"),
            (["One estimate", "rig, lenses, poses, planes"], "box"),
            (["Dense check", "clouds within their sigmas"], "box"),
            (["Cloud, mesh, floor plan", "every length with its sigma"], "c"),
        ],
    )
    return drawing


def turntable() -> Drawing:
    """A thing that turns before a resting rig, and how its stations are joined."""
    drawing = Drawing(
        *(760, 440),
        "A thing on a turntable",
        "The thing turns between stations before a resting rig. What rests is removed, pairs are registered, "
        "and one estimate turns all stations about one axis.",
    )
    centre = (222.0, 150.0)
    drawing.area([(24, 24), (420, 24), (420, 300), (24, 300)], "box")
    drawing.text(36, 44, "table: rests, left out", "quiet")
    drawing.circle(centre, 112, "dash")
    for turn in (0.0, 30.0, 60.0):
        shape = [_around(centre, radius, turn + angle) for angle, radius in _THING]
        drawing.area(shape, "c" if turn == 0 else "thin")
    drawing.circle(centre, 4, "c")
    drawing.line([_around(centre, 126, angle) for angle in range(-70, -14, 5)], "line", arrow=True)
    drawing.text(centre[0] + 96, 60, "30°", "bold")
    projector, camera = (140.0, 350.0), (304.0, 350.0)
    for device, style in ((projector, "b"), (camera, "a")):
        for side in (-40.0, 40.0):
            drawing.line([device, (centre[0] + side, centre[1] + 38)], f"{style}-line")
    drawing.box(projector[0] - 46, projector[1], 92, 34, ["projector"], "b")
    drawing.box(camera[0] - 40, camera[1], 80, 34, ["camera"], "a")
    drawing.text(222, 412, "calibrated rig at rest", "quiet", "middle")
    _flow(
        drawing,
        20,
        [
            (["Stations", "a cloud from each turn"], "a"),
            (["Removal of what rests", "table, wall, turntable's plate"], "box"),
            (["Pairs of stations", "features, surfaces, free space"], "box"),
            (["Groups", "members place the next station"], "box"),
            (["One estimate", "turns about one axis, if they are"], "box"),
            (["Cloud, surface, volume", "with sigmas"], "c"),
        ],
    )
    return drawing


_THING = [(0, 80), (40, 55), (85, 70), (130, 46), (180, 66), (225, 40), (270, 60), (315, 52)]


def network() -> Drawing:
    """Devices as nodes, captures as edges."""
    drawing = Drawing(
        *(760, 304),
        "A network of cameras and projectors",
        "Two cameras and two projectors are nodes, each capture of a pair is an edge. The pair that sees a "
        "corner starts the estimate, the others follow by shared light.",
    )
    cameras, projectors = {"left": 70.0, "right": 230.0}, {"stage": 70.0, "side": 230.0}
    for camera, y in cameras.items():
        for projector, other in projectors.items():
            first = (camera, projector) == ("left", "stage")
            drawing.line([(136, y), (320, other)], "c-line" if first else "dash")
    for names, x, style, kind in ((cameras, 24.0, "a", "camera"), (projectors, 320.0, "b", "projector")):
        for name, y in names.items():
            drawing.box(x, y - 26, 112, 52, [name, kind], style)
    drawing.text(228, 58, "sees a corner:", "bold", "middle")
    drawing.text(228, 90, "left-stage", "quiet", "middle")
    drawing.text(228, 222, "right-side", "quiet", "middle")
    drawing.text(228, 284, "each line is a capture of one pair", "quiet", "middle")
    _flow(
        drawing,
        16,
        [
            (["Corner of one pair", "first devices and planes"], "a"),
            (["Shared light", "places the other devices"], "box"),
            (["One estimate", "devices, poses, planes"], "box"),
            (["Do the cameras agree?", "the same point from each"], "c"),
        ],
    )
    return drawing


def _flow(drawing: Drawing, top: float, steps: Sequence[tuple[list[str], str]]) -> None:
    """Steps from top to bottom at the right."""
    middle = _FLOW_LEFT + _FLOW_WIDTH / 2
    for number, (lines, style) in enumerate(steps):
        y = top + number * 70
        if number:
            drawing.line([(middle, y - 22), (middle, y - 2)], arrow=True)
        drawing.box(_FLOW_LEFT, y, _FLOW_WIDTH, 48, lines, style)


def _to_wall(place: Point, degrees: float) -> Point:
    """Where a ray from a place in the drawn room meets its wall."""
    (x, y), (across, down) = place, (cos(radians(degrees)), sin(radians(degrees)))
    reach = min(((420 if across > 0 else 24) - x) / across, ((370 if down > 0 else 24) - y) / down)
    return x + reach * across, y + reach * down


def _around(centre: Point, radius: float, degrees: float) -> Point:
    return centre[0] + radius * cos(radians(degrees)), centre[1] + radius * sin(radians(degrees))
