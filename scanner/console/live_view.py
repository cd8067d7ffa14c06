"""The newest live cloud in the browser, with what it is worth, and a button that keeps it."""

import logging
import time
from collections.abc import Callable
from threading import Thread

import numpy as np
import viser

from calib.geometry import IDENTITY, Calibration
from hw.rig import Frame
from scanner.live import Account, LiveCloud, Newest, Watcher, Wishes, round_texts
from scanner.rendering import photograph
from scanner.viewing import CloudScene, CloudWithSigma, Colouring, PlacedRig, bar_html, escaped

log = logging.getLogger(__name__)

# What a page on this computer takes and draws while the decoder works beside it.
_SHOWN, _EVERY_S = 200_000, 0.2
_REMEMBERED = 5
_COLOURINGS = {colouring.value: colouring for colouring in (Colouring.CAMERA, Colouring.SIGMA)}


class LiveView(Watcher):
    """A folder in the container that is open when it is made. Clouds are drawn in a thread of its own, the newest ones
    only: whoever is slow gets fewer of them, and nobody waits for the page. `on_frame` is given one frame of each.
    """

    def __init__(
        self, gui: viser.GuiApi, scene: CloudScene, on_frame: Callable[[Frame], None] = lambda _: None
    ) -> None:
        self._scene, self._on_frame = scene, on_frame
        self._wishes = Wishes()
        self._calibration: Calibration | None = None
        self._picked = np.empty(0)
        self._newest = Newest[tuple[LiveCloud | None, list[str]]]()
        self._sentences: list[str] = []
        self._folder = gui.add_folder("Live clouds", visible=False)
        with self._folder:
            self._message = gui.add_markdown("No cloud yet.")
            self._keep = gui.add_button("Keep this cloud", hint="As a station of a thing. Key: Shift+K")
            self._colours = gui.add_dropdown("Colour", tuple(_COLOURINGS))
            self._bar = gui.add_html("")
            self._log = gui.add_markdown("")
        self._keep.on_click(lambda _: self._wishes.now.set())
        gui.add_command("Keep this cloud", hotkey="K", modifier="shift").on_trigger(lambda _: self._wishes.now.set())
        Thread(target=self._draw, name="live view", daemon=True).start()

    def begin(self, calibration: Calibration, wishes: Wishes) -> None:
        """Clouds of a rig are about to come; what is pressed becomes one of the `wishes`."""
        self._calibration, self._wishes, self._sentences = calibration, wishes, []
        self._picked = np.empty(0)
        self._folder.visible = True

    def on_round(self, cloud: LiveCloud | None, account: Account) -> None:
        """Returns at once."""
        unit = self._calibration.unit if self._calibration else ""
        self._newest.put((cloud, round_texts(cloud, account, unit)))

    def tell(self, sentence: str) -> None:
        """Show it above the last few."""
        self._sentences = [sentence, *self._sentences][:_REMEMBERED]
        self._log.content = "\n".join(f"- {escaped(sentence)}" for sentence in self._sentences)

    def _draw(self) -> None:
        while (newest := self._newest.take()) is not None:
            began_s = time.monotonic()
            cloud, sentences = newest
            self._message.content = "\n\n".join(map(escaped, sentences))
            if cloud is not None and len(cloud.points):
                try:
                    self._on_frame(cloud.taken.frames[-1])
                    self._show(cloud)
                except Exception:  # the next cloud may be drawn, and the camera does not care
                    log.exception("a live cloud could not be shown")
            time.sleep(max(0.0, began_s + _EVERY_S - time.monotonic()))

    def _show(self, cloud: LiveCloud) -> None:
        calibration, first = self._calibration, not len(self._picked)
        if calibration is None:
            return
        if first:
            self._picked = np.random.default_rng(0).random(cloud.reason.size)
        # Of a pixel the same is decided in every cloud, or they would flicker.
        chosen = np.flatnonzero(self._picked[cloud.pixel] < _SHOWN / len(cloud.pixel))
        levels = cloud.picture.ravel()[cloud.pixel[chosen]]
        grey = np.rint(255.0 / max(1, int(levels.max(initial=1))) * levels).astype(np.uint8)
        cloud_view = CloudWithSigma(
            cloud.points[chosen].astype(np.float64),
            np.zeros((len(chosen), 3)),
            np.repeat(grey[:, None], 3, axis=1),
            (PlacedRig(calibration, IDENTITY, photograph(cloud.picture)),) if first else (),
            None,
            np.array([0.0, -1.0, 0.0]),
            calibration.unit,
            "camera",
            cloud.sigma[chosen].astype(np.float64),
        )
        if first:
            self._scene.show(cloud_view)
        drawn = self._scene.follow(cloud_view, _COLOURINGS[self._colours.value])
        self._bar.content = bar_html(self._colours.value, drawn.coloured.bar)
