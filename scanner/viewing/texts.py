"""Texts of the panel about a result, as Markdown."""

from collections.abc import Iterator

from markupsafe import escape

from calib.geometry import Calibration
from scanner.measuring import angle_cells
from scanner.quantities import Quantity, device_quantities, fine_unit, pose_quantities, truth_line
from scanner.rendering import css_colour
from scanner.results import DECISIVE, Verdict
from scanner.shown_text import unbroken
from scanner.viewing.colouring import ColourBar
from scanner.viewing.corner import MeasuredCorner


def escaped(text: str) -> str:
    """Text from a file or a message as Markdown that shows it and nothing else, and breaks no line within a number."""
    return "".join(f"\\{letter}" if letter in "\\`*_{}[]<>#|$~" else letter for letter in unbroken(text))


def bold(text: str) -> str:
    """A message, to be seen."""
    return "\n\n".join(f"**{escaped(line)}**" for line in text.splitlines() if line.strip())


def notes_text(verdict: Verdict | None) -> str:
    """Return the report's further reasons and findings on a result; '' if there are none."""
    said = () if verdict is None else (*verdict.reasons[DECISIVE:], *map(str, verdict.further))
    return "\n".join(f"- {escaped(sentence)}" for sentence in said)


def link_html(address: str, text: str) -> str:
    """A link that opens in another tab."""
    return f'<p class="scan-link"><a href="{escape(address)}" target="_blank" rel="noopener">{escape(text)}</a></p>'


def bar_html(title: str, bar: ColourBar | None) -> str:
    """What the colours mean, over the view: shades, with labels at both ends and in the middle; '' for none."""
    if bar is None:
        return ""
    shades = ", ".join(css_colour((int(r), int(g), int(b))) for r, g, b in bar.shades[:: max(1, len(bar.shades) // 16)])
    ends = "".join(f"<span>{escape(text)}</span>" for text in (bar.low, bar.middle, bar.high))
    return (
        f'<div class="scan-over">{escape(title)}<div class="scan-bar" role="img" aria-label="colours from '
        f'{escape(bar.low)} to {escape(bar.high)}"><div style="background: linear-gradient(to right, {shades})"></div>'
        f"<p>{ends}</p></div></div>"
    )


def verdict_text(verdict: Verdict | None) -> str:
    """The verdict with its reasons, or where to find it."""
    if verdict is None:
        return "This result does not state its verdict. Its report.html does."
    lines = [f"**{verdict.sign} {escaped(verdict.headline)}**", ""]
    lines += [f"- {escaped(reason)}" for reason in verdict.reasons[:DECISIVE]]
    if verdict.advice:
        lines += ["", escaped(verdict.advice)]
    return "\n".join(lines)


def calibration_text(calibration: Calibration, truth: Calibration | None) -> str:
    """Return every parameter with its sigma, and the truth if it is known."""
    known = truth is not None
    lines = [f"| | value | sigma |{' truth |' if known else ''}", f"|:--|--:|--:|{'--:|' if known else ''}"]
    baseline = [quantity for quantity in pose_quantities(calibration, truth) if quantity.name == "baseline"]
    for heading, quantities in (
        ("Camera", device_quantities("camera", calibration, truth)),
        ("Projector", device_quantities("projector", calibration, truth)),
        ("Between them", baseline),
    ):
        lines.append(f"| **{heading}** | | |{' |' if known else ''}")
        lines += [_row(quantity, known) for quantity in quantities]
    if truth is not None:
        lines += ["", truth_line(calibration, truth)]
    return "\n".join(lines)


def _row(quantity: Quantity, known: bool) -> str:
    name = quantity.name + (f", {quantity.unit}" if quantity.unit else "")
    sigma = "" if quantity.sigma is None else f"± {quantity.shown(quantity.sigma)}" if quantity.sigma else "given"
    truth = f" {quantity.shown(quantity.truth)} |" if known else ""
    return f"| {name} | {quantity.shown(quantity.value)} | {sigma} |{truth}"


def corner_text(corner: MeasuredCorner | None, unit: str) -> str:
    """The faces' flatness and the angles between them."""
    if corner is None:
        return "The matches do not say which points are on the three faces."
    return "\n".join(_corner_lines(corner, unit))


def _corner_lines(corner: MeasuredCorner, unit: str) -> Iterator[str]:
    unit_shown = fine_unit(unit)
    yield corner.scene.sentence
    yield ""
    for angle in corner.scene.angles:
        yield f"- {angle_name(angle.faces)}: {' '.join(angle_cells(angle))}"
    for face in corner.scene.faces:
        yield f"- Face {face.name}: flat to {unit_shown.length(face.deviation, face.budget.sigma)}"


def angle_name(faces: tuple[str, str]) -> str:
    """Return the name of the angle between two faces."""
    return f"Angle {faces[0]}–{faces[1]}"
