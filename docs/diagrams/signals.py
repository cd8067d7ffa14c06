"""Diagrams of what becomes of frames: the decoder's stages, phase unwrapping."""

from collections.abc import Callable

from diagrams.drawing import Drawing

_PERIOD_PX, _CELL_PX, _WIDTH_PX = 16, 8, 64
_SLIP_PX = (37, 43)  # where the drawn code is off by one period


def decoder() -> Drawing:
    """From frames to matches."""
    drawing = Drawing(
        *(760, 520),
        "The stages of decoding",
        "Frames, an estimate of what happened to them, corrected frames, code and phase, phase unwrapping, "
        "checks, and matches or masked pixels.",
    )
    drawing.box(290, 14, 180, 44, ["Frames", "one for each pattern"], "a")
    drawing.line([(380, 58), (380, 80)], arrow=True)
    drawing.box(16, 82, 728, 96)
    drawing.text(380, 104, "What happened to whole frames, estimated from a sample of pixels", "bold", "middle")
    causes = [("gains", "lamp, mains"), ("ghosting", "slow panel"), ("ambient light", "lamp switched")]
    causes += [("response", "gamma"), ("tone curve", "photographs"), ("motion", "bump, drift")]
    for number, cause in enumerate(causes):
        drawing.box(28 + number * 118, 118, 112, 48, cause, "b")
    drawing.line([(380, 178), (380, 200)], arrow=True)
    drawing.box(290, 202, 180, 32, ["Corrected frames"], "a")
    drawing.line([(340, 234), (220, 262)], arrow=True)
    drawing.line([(420, 234), (540, 262)], arrow=True)
    drawing.box(80, 264, 280, 48, ["Code", "pattern against inverse: the cell"])
    drawing.box(400, 264, 280, 48, ["Fringes", "steps of a cosine: the phase"])
    drawing.line([(220, 312), (340, 338)], arrow=True)
    drawing.line([(540, 312), (420, 338)], arrow=True)
    drawing.box(200, 340, 360, 48, ["Phase unwrapping", "coordinate and sigma of x and y"])
    drawing.line([(380, 388), (380, 408)], arrow=True)
    drawing.box(200, 410, 360, 32, ["Checks: neighbours, epipolar geometry"])
    drawing.line([(300, 442), (220, 466)], arrow=True)
    drawing.line([(460, 442), (540, 466)], arrow=True)
    drawing.box(80, 468, 280, 40, ["Matches with sigma"], "c")
    drawing.box(400, 468, 280, 40, ["Masked pixels with a reason"])
    return drawing


def unwrapping() -> Drawing:
    """Bits of a Gray code, the wrapped phase, and the coordinate with one period slip."""
    drawing = Drawing(
        *(760, 420),
        "Phase unwrapping",
        "The phase of a fringe repeats every period. The cell of the Gray code selects the period. Where a "
        "bit is wrong, the coordinate is off by a whole period: a period slip.",
    )
    left, scale = 130.0, 9.5

    def across(px: float) -> float:
        return left + px * scale

    for bit in range(3):
        y = 24.0 + bit * 30
        drawing.text(16, y + 18, f"bit {bit + 1}")
        drawing.box(left, y, _WIDTH_PX * scale, 24)
        stripe = 2 * _CELL_PX << (2 - bit)  # of a Gray code: twice its cell, from half of that on
        for start in range(stripe // 2, _WIDTH_PX, 2 * stripe):
            drawing.box(across(start), y, min(stripe, _WIDTH_PX - start) * scale, 24, style="b")
    drawing.text(16, 164, "phase")
    drawing.text(16, 181, "of the fringe", "quiet")
    _trace(drawing, across, lambda px: 206 - 4 * (px % _PERIOD_PX), range(_WIDTH_PX + 1), "a-line")
    drawing.text(16, 310, "coordinate")
    low, high = _SLIP_PX
    _trace(drawing, across, lambda px: 380 - 2 * px, [px for px in range(_WIDTH_PX + 1) if px <= low], "c-line")
    _trace(drawing, across, lambda px: 380 - 2 * px, [px for px in range(_WIDTH_PX + 1) if px >= high], "c-line")
    _trace(drawing, across, lambda px: 380 - 2 * (px - _PERIOD_PX), range(low, high + 1), "b-line")
    _trace(drawing, across, lambda px: 380 - 2 * px, range(low, high + 1), "dash")
    drawing.text(across(high) + 12, 348, "period slip", "bold")
    drawing.line([(across(high) + 8, 343), (across(high) - 18, 333)], "thin", arrow=True)
    for period in range(_WIDTH_PX // _PERIOD_PX + 1):
        x = across(period * _PERIOD_PX)
        drawing.line([(x, 120), (x, 386)], "dash")
        drawing.text(x, 404, f"{period * _PERIOD_PX}", "quiet", "middle")
    drawing.text(16, 404, "column, px", "quiet")
    return drawing


def _trace(
    drawing: Drawing,
    across: Callable[[float], float],
    height: Callable[[float], float],
    at: range | list[int],
    style: str,
) -> None:
    """A curve over columns, broken where it jumps back."""
    run: list[tuple[float, float]] = []
    for px in at:
        if run and height(px) > run[-1][1] + 30:
            drawing.line([*run, (across(px), run[-1][1] - 4)], style)
            run = []
        run.append((across(px), height(px)))
    if len(run) > 1:
        drawing.line(run, style)
