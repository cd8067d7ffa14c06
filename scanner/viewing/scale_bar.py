"""A scale bar for the middle of a window's view, in the cloud's unit."""

from dataclasses import dataclass

from markupsafe import escape

from scanner.quantities import shown_unit
from scanner.viewing.geometry import nice_step

_WANTED_PX = 560  # four times the length that it is about to have


@dataclass(frozen=True)
class ScaleBar:
    """A bar of `width_px` pixels, which is as long as `text` says at the middle of the view."""

    width_px: float
    text: str


def scale_bar(px_per_unit: float, unit: str, density: int = 1) -> ScaleBar:
    """Return a bar of a round length; `px_per_unit` pixels are one of the cloud's unit, `density` one of the page."""
    shown = shown_unit(unit)
    step = nice_step(shown.factor * density * _WANTED_PX / px_per_unit)
    name = "baseline" if step == 1 and shown.name == "baselines" else shown.name
    return ScaleBar(step / shown.factor * px_per_unit, f"{step:g} {name}")


def scale_bar_html(bar: ScaleBar, height: int) -> str:
    """It, over the view, which is `height` of its pixels high and as high as the page."""
    text = escape(bar.text)
    return (
        f'<div class="scan-scale" role="img" aria-label="scale bar: {text}" title="At the middle of the view: what is '
        f'nearer looks larger"><div style="width: {100 * bar.width_px / height:.3f}vh"></div><p>{text}</p></div>'
    )
