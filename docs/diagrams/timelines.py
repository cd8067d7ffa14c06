"""Diagrams over time: acquisition, motion within a capture, live rounds, films."""

from diagrams.drawing import Drawing

_EXPOSURE_MS, _LATENCY_MS, _TRANSFER_MS, _MARGIN_MS = 33.0, 50.0, 3.0, 5.0
_LEFT = 92.0


def acquisition() -> Drawing:
    """Screen, wall and camera, sequential and pipelined, with the exposure and latency of docs/speed.md."""
    drawing = Drawing(
        *(760, 372),
        "Sequential and pipelined acquisition",
        "Sequential: each picture waits for the frame of the last one, 2.6 exposures a frame. Pipelined: "
        "pictures follow each other on the wall, the latency is paid once.",
    )
    sequential = _EXPOSURE_MS + _LATENCY_MS + _TRANSFER_MS
    _rows(drawing, 16, "Sequential: each picture waits for the last frame", sequential)
    _rows(
        drawing, 190, "Pipelined: the next picture is on its way while this one is exposed", _EXPOSURE_MS + _MARGIN_MS
    )
    drawing.line([(_LEFT, 350), (740, 350)], "thin", arrow=True)
    drawing.text(740, 366, "time", "quiet", "end")
    return drawing


def _rows(drawing: Drawing, top: float, title: str, interval_ms: float) -> None:
    """Pictures swapped every interval, on the wall a latency later, and exposed there."""
    scale, end = 1.75, 740.0
    drawing.text(16, top + 14, title, "bold")
    rows = {"screen": top + 28, "wall": top + 70, "camera": top + 112}
    for name, y in rows.items():
        drawing.text(16, y + 22, name)
    for number in range(1, 10):
        swap = _LEFT + (number - 1) * interval_ms * scale
        after = swap + interval_ms * scale
        lit, until = swap + _LATENCY_MS * scale, min(after + _LATENCY_MS * scale, end)
        exposed = lit + (_MARGIN_MS / 2 if interval_ms < _LATENCY_MS else 0) * scale
        if exposed + _EXPOSURE_MS * scale > end:
            break
        drawing.box(swap, rows["screen"], min(after, end) - swap - 2, 32, [f"{number}"], "b")
        drawing.box(lit, rows["wall"], until - lit - 2, 32, [f"{number}"], "b")
        drawing.box(exposed, rows["camera"], _EXPOSURE_MS * scale, 32, [f"{number}"], "a")
        if number == 1:
            drawing.line([(swap, rows["screen"] + 36), (lit, rows["wall"] - 4)], "thin", arrow=True)
            drawing.text(swap + 58, rows["wall"] + 20, "latency", "quiet", "end")


def motion() -> Drawing:
    """Fringes in the presets' order and all x before all y, before a steady drift."""
    drawing = Drawing(
        *(760, 330),
        "Order of fringes and motion",
        "In the presets' order the fringes of x and y have the same mean time, so that a drift shifts both "
        "alike. With all x before all y their mean times differ, and the drift shifts one axis against the "
        "other.",
    )
    orders = {
        "Presets: x and y have the same mean time": ["x0", "x1", "y0", "y1", "y2", "y3", "x3", "x2"],
        "All x before all y: the drift shifts y against x": ["x0", "x1", "x2", "x3", "y0", "y1", "y2", "y3"],
    }
    width = 80.0
    for row, (title, order) in enumerate(orders.items()):
        top = 16 + row * 154
        drawing.text(16, top + 14, title, "bold")
        drawing.line([(16, top + 124), (16 + 8 * width, top + 84)], "line")
        drawing.text(672, top + 90, "drift", "quiet")
        for number, frame in enumerate(order):
            drawing.box(16 + number * width, top + 26, width - 4, 30, [frame], "a" if frame[0] == "x" else "b")
        for axis, style in (("x", "a"), ("y", "b")):
            mean = sum(number for number, frame in enumerate(order) if frame[0] == axis) / 4 + 0.5
            x, y = 16 + mean * width - 2, top + 124 - 5 * mean
            drawing.line([(x, top + 60), (x, y)], f"{style}-line")
            drawing.circle((x, y), 4 if axis == "y" else 7, style)
        shared = order[1] == "x1" and order[2] == "y0"
        for axis, at in (("x and y", 4.0),) if shared else (("x", 2.0), ("y", 6.0)):
            drawing.text(16 + at * width + 8, top + 78, f"mean of {axis}", "quiet")
    return drawing


def live() -> Drawing:
    """Rounds of six frames and what becomes of them."""
    drawing = Drawing(
        *(760, 250),
        "Rounds of a live scan",
        "Each round has three steps of a long and three of a short fringe along one axis. It becomes a cloud "
        "while the next round is taken; what changed since the round before is moving.",
    )
    width = 38.0
    for number in range(3):
        left = 16 + number * 6.3 * width
        drawing.text(left, 30, f"round {number + 1}", "bold")
        for step in range(6):
            style, name = ("a", "L") if step % 2 == 0 else ("b", "S")
            drawing.box(left + step * width, 40, width - 3, 34, [f"{name}{step // 2 + 1}"], style)
        middle = left + 3 * width
        drawing.line([(middle, 78), (middle, 104)], arrow=True)
        drawing.box(middle - 88, 106, 176, 44, ["both phases", "agree: keep the pixel"])
        drawing.line([(middle, 150), (middle, 176)], arrow=True)
        drawing.box(middle - 50, 178, 100, 30, [f"cloud {number + 1}"], "c")
        if number:
            drawing.line([(middle - 6.3 * width + 90, 128), (middle - 90, 128)], "dash", arrow=True)
    drawing.text(16, 236, "L: long fringe, S: short fringe, three steps each, along one axis", "quiet")
    drawing.text(744, 236, "dashed: changes are motion", "quiet", "end")
    return drawing


def film() -> Drawing:
    """Frames of a rolling shutter against the pictures of a video."""
    drawing = Drawing(
        *(760, 330),
        "Exposures of a film against the pictures of the video",
        "Rows of a frame are exposed one after the other. Rows during which one picture was shown are "
        "averaged; rows during which the picture changed are solved for.",
    )
    hold, period, exposure, readout = 150.0, 80.0, 40.0, 62.0
    left, top, bottom, pictures = 92.0, 92.0, 250.0, 4
    drawing.text(16, 48, "pictures")
    drawing.text(16, 160, "rows of")
    drawing.text(16, 177, "frames")
    for number in range(pictures):
        x = left + number * hold
        drawing.box(x, 26, hold - 2, 36, [f"picture {number + 1}"], "b")
        drawing.line([(x, 66), (x, bottom + 8)], "dash")
    drawing.line([(left + pictures * hold, 66), (left + pictures * hold, bottom + 8)], "dash")
    start = left + 6
    while start + readout + exposure < left + pictures * hold:
        changes = [left + number * hold for number in range(1, pictures)]
        spans = [((change - start - exposure) / readout, (change - start) / readout) for change in changes]
        mixed = next(((max(a, 0.0), min(b, 1.0)) for a, b in spans if a < 1 and b > 0), (1.0, 1.0))
        for first, last, style in ((0.0, mixed[0], "a"), (*mixed, "b"), (mixed[1], 1.0, "a")):
            if last > first:
                sides = ((first, 0.0), (first, exposure), (last, exposure), (last, 0.0))
                drawing.area([(start + row * readout + x, top + row * (bottom - top)) for row, x in sides], style)
        start += period
    drawing.line([(left, bottom + 16), (740, bottom + 16)], "thin", arrow=True)
    drawing.text(740, bottom + 34, "time", "quiet", "end")
    drawing.box(left, 292, 18, 18, style="a")
    drawing.text(left + 26, 306, "one picture alone: averaged")
    drawing.box(left + 290, 292, 18, 18, style="b")
    drawing.text(left + 316, 306, "two pictures: solved for")
    return drawing
