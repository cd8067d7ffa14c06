"""The page's live image: the picture, how it is exposed, and what can be set about it."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import viser
from viser import uplot

from hw.backends import RigSettings
from hw.rig import Frame, Rig, settable_exposure
from hw.settings import CameraRigSettings
from scanner.console.picture import HISTOGRAM_BINS, LargeImage, Shown, exposed, histogram, sharpness, shown
from scanner.console.settings import IdlePicture
from scanner.quantities import percent
from scanner.rendering import Pixels, jpeg_uri

_EVERY_S = 0.15  # a page and a network have to keep up
_THUMBNAIL_PX = 320
_LONGEST_MS = 10_000.0
_FONT = "12px sans-serif"
_LINE, _FILL = "#444444", "#bbbbbb"

Change = Callable[..., None]


class CameraView:
    """Built into the container that is open when it is made; `change` takes the settings that the operator changes."""

    def __init__(self, gui: viser.GuiApi, large: LargeImage, settings: RigSettings, change: Change) -> None:
        self._large, self._change = large, change
        self._sharpest = 0.0
        self._highest_level = 255
        self._shown_s = 0.0
        self._image = gui.add_html("")
        self._message = gui.add_markdown("No frame yet.")
        self._mark = gui.add_checkbox(
            "Mark extremes", initial_value=True, hint="Clipped pixels in orange-red, dark ones in blue"
        )
        self._picture = gui.add_dropdown("Projector", [picture.value for picture in IdlePicture])
        self._exposure = gui.add_number("Exposure, ms", 0.0, min=0.0, max=_LONGEST_MS, step=0.1)
        self._add_gain(gui, settings)
        self._histogram = _histogram_plot(gui)
        self._picture.on_update(lambda _: self._change_picture())
        self._exposure.on_update(self._on_exposure)

    def set_exposure(self, exposure_us: float) -> None:
        """Take an exposure as the operator's."""
        self._exposure.value = round(exposure_us / 1000, 3)
        self._change(exposure_us=exposure_us)

    def on_camera(self, rig: Rig) -> None:
        """The rig is open: its camera's limits are known."""
        self._sharpest = 0.0
        self._highest_level = rig.camera.highest_level
        camera = settable_exposure(rig.camera)
        self._exposure.disabled = camera is None
        if camera is not None:
            low_us, high_us = camera.exposure_limits_us
            self._exposure.min, self._exposure.max = max(0.0, low_us / 1000), min(_LONGEST_MS, high_us / 1000)
            self._exposure.value = round(camera.exposure_us / 1000, 3)

    def on_frame(self, frame: Frame, camera: str = "") -> None:
        """Show a frame, unless the last one was shown a moment ago."""
        now_s = time.monotonic()
        if now_s - self._shown_s < _EVERY_S:
            return
        self._shown_s = now_s
        self._image.content = _html(
            shown(frame.image, self._highest_level, mark_clipped=self._mark.value, longest_side=_THUMBNAIL_PX)
        )
        light = exposed(frame.image, self._highest_level)
        exposure = "" if frame.exposure_us is None else f"Exposed for {frame.exposure_us / 1000:.4g} ms. "
        self._message.content = (
            f"{exposure}Clipped: {percent(light.clipped)}, dark: {percent(light.dark)} of the pixels; median "
            f"{100 * light.median:.0f} % of the range."
        )
        levels, counts = histogram(frame.image, self._highest_level)
        self._histogram.data = (levels, np.maximum(counts, 1.0))
        sharp = sharpness(frame.image)
        self._sharpest = max(self._sharpest, sharp)
        focus = f"{100 * sharp / self._sharpest:.0f} % of the sharpest so far" if self._sharpest else "no light"
        lines = (
            f"Clipped {percent(light.clipped)}, dark {percent(light.dark)}",
            f"Focus, in the middle: {focus}",
            "A click shows single pixels, another the whole",
        )
        name = (camera,) if camera else ()
        self._large.show(Shown(frame.image, self._highest_level, self._mark.value, (*name, *lines), counts))

    def _change_picture(self) -> None:
        self._sharpest = 0.0  # stripes have more detail than white
        self._change(picture=IdlePicture(self._picture.value))

    def _on_exposure(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is not None and self._exposure.value > 0:  # else it was set by the program, to what is so
            self._change(exposure_us=1000 * float(self._exposure.value))

    def _add_gain(self, gui: viser.GuiApi, settings: RigSettings) -> None:
        """Add the gain control, which only some real cameras have."""
        if not isinstance(settings, CameraRigSettings) or not settings.has_gain:
            return
        gain = gui.add_number("Gain", float(settings.gain or 0.0), step=0.1, hint="In the camera's own unit, mostly dB")
        gain.on_update(lambda event: self._change(gain=float(gain.value)) if event.client else None)


def _html(picture: Pixels) -> str:
    """The picture, small. Viser's own image complains in the browser's console when it changes fast."""
    style = "width: 60%; padding: 0 0.7em; box-sizing: border-box"
    return f'<img alt="what the camera sees" style="{style}" src="{jpeg_uri(picture)}">'


def _histogram_plot(gui: viser.GuiApi) -> viser.GuiUplotHandle:
    levels = np.linspace(0, 100, HISTOGRAM_BINS)
    return gui.add_uplot(
        (levels, np.ones(HISTOGRAM_BINS)),
        (
            uplot.Series(label="brightness"),
            uplot.Series(label="pixels", stroke=_LINE, fill=_FILL, width=1),
        ),
        scales={"x": uplot.Scale(time=False, auto=False, range=(0, 100)), "y": uplot.Scale(distr=3, log=10)},
        axes=(
            uplot.Axis(label="brightness, % of the camera's range", font=_FONT, labelFont=_FONT),
            uplot.Axis(show=False),
        ),
        legend=uplot.Legend(show=False),
        padding=(8, 16, 0, 16),
        aspect=2.5,
    )
