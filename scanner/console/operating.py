"""The top of the page: what is being done, how long it takes, and the buttons that begin and
end it, with a sound for an operator who looks elsewhere.
"""

import base64
import wave
from collections.abc import Callable
from functools import cache, partial
from io import BytesIO

import numpy as np
import viser

from scanner.console.results import SCANS, newest_calibration
from scanner.console.settings import plain_name
from scanner.console.texts import guidance_text, status_text
from scanner.console.worker import Activity, Status, Worker
from scanner.viewing import PLAIN, HintedButton

_RATE_HZ = 22_050
_TONES_HZ, _TONE_S, _FADE_S = (660.0, 880.0), 0.18, 0.02
_LOUDNESS = 0.3


@cache
def chime() -> str:
    """Two tones, as the data URI of a WAV file."""
    at = np.arange(int(_RATE_HZ * _TONE_S)) / _RATE_HZ
    shape = np.minimum(1.0, np.minimum(at, at[-1] - at) / _FADE_S)
    samples = np.concatenate([shape * np.sin(2 * np.pi * tone_hz * at) for tone_hz in _TONES_HZ])
    file = BytesIO()
    with wave.open(file, "wb") as sound:
        sound.setnchannels(1)
        sound.setsampwidth(2)
        sound.setframerate(_RATE_HZ)
        sound.writeframes(np.rint(_LOUDNESS * 32767 * samples).astype("<i2").tobytes())
    return f"data:audio/wav;base64,{base64.b64encode(file.getvalue()).decode('ascii')}"


def playing(number: int) -> str:
    """An element that plays it once; another `number`, another time."""
    return f'<audio autoplay class="scan-hidden" data-number="{number}" src="{chime()}"></audio>'


_MOST_CAPTURES = 8
_SCAN, _CANCEL, _CHECK, _LIVE, _CLOUDS, _NETWORK = ("Scan", "Cancel", "Check", "Live image", "Live clouds", "Network")
_KEYS = (
    "Keys, each with Shift: S scan, C check, L live image, D live clouds, K keep one, N network, X cancel; pages: "
    "I capture, R result, H history."
)


class Operating:
    """Built into the container that is open when it is made. One button stands out: what one presses next."""

    def __init__(self, gui: viser.GuiApi, worker: Worker, begin_check: Callable[[], None]) -> None:
        self._worker = worker
        self._sounded = 0
        self._message = gui.add_markdown("Starting …")
        self._bar = gui.add_progress_bar(0.0, visible=False)
        self._guidance = gui.add_markdown("", visible=False)
        self._go_on = gui.add_button("Next capture", visible=False, hint="The rig stands where it is to capture from")
        self._enough = gui.add_button("Enough: use what there is", visible=False, color=PLAIN)
        self._has_network = False
        self._buttons = {
            label: self._bind(gui, label, key, action, hint)
            for label, key, action, hint in (
                (_SCAN, "S", partial(worker.request, Activity.SCANNING), f"Capture, calibrate, reconstruct. {_KEYS}"),
                (_CANCEL, "X", worker.cancel, "Stop; what was captured is kept"),
                (_CHECK, "C", begin_check, "Look at devices, light and lenses first"),
                (_LIVE, "L", self._toggle_live, "Show what the camera sees"),
                (_CLOUDS, "D", partial(worker.request, Activity.CLOUDS), "Of a calibrated rig: what it sees, in 3-D"),
                (_NETWORK, "N", partial(worker.request, Activity.NETWORK), "Capture and calibrate all devices"),
            )
        }
        self._buttons[_CANCEL].visible = False
        with gui.add_folder("Next scan", expand_by_default=False):
            self._name = gui.add_text("Name", "", hint="Of the next result, in scans/; empty: the configuration's")
            self._captures = gui.add_number(
                "Captures", 1, min=1, max=_MOST_CAPTURES, step=1, hint="Of one corner, between which the rig is moved"
            )
            self._sound = gui.add_checkbox("Sound after a capture", initial_value=False)
        self._player = gui.add_html("")
        self._connect()

    def show(self, status: Status) -> None:
        """Say it, and offer what can be done now."""
        self.tick(status)
        asked, busy = bool(status.question), status.busy
        self._guidance.content, self._guidance.visible = guidance_text(status.guidance), bool(status.guidance)
        self._go_on.visible = self._enough.visible = asked
        self._buttons[_SCAN].visible, self._buttons[_CANCEL].visible = not busy, busy
        self._bar.visible = busy and not asked
        counted = status.stage is not None and status.stage.total > 0
        self._bar.value = status.stage.percent if status.stage and counted else 100.0
        self._bar.animated = not counted  # what cannot be counted moves without getting on
        self._buttons[_LIVE].label = "Stop the live image" if status.activity is Activity.LIVE else _LIVE

    def prefer_network(self, preferred: bool) -> None:
        """Whether one presses Network next, or Scan."""
        self._has_network = preferred
        self._buttons[_NETWORK].stand_out(main=preferred)
        self._buttons[_SCAN].stand_out(main=not preferred)
        self._allow(self._worker.status)

    def tick(self, status: Status) -> None:
        """Say how long it will take, as time goes by."""
        self._message.content = status_text(status)
        self._allow(status)

    def _allow(self, status: Status) -> None:
        """Disable the buttons that cannot work now, and say why."""
        settings = self._worker.settings
        busy = f"{status.activity} is running. Cancel ends it." if status.busy else ""
        several = self._has_network and settings.pair is None
        unclear = "There are several devices: choose a pair of them in Look at, or press Network." if several else ""
        known = settings.calibration or newest_calibration()
        unknown = "" if known else f"The rig is not calibrated: there is no result with a calibration in {SCANS}."
        alone = "" if self._has_network else "The configuration names no network: it has no section rigs."
        for label, reasons in (
            (_SCAN, (busy, unclear)),
            (_CANCEL, ("It stops after the present step." if status.cancelling else "",)),
            (_CHECK, (busy, unclear)),
            (_LIVE, (busy,)),
            (_CLOUDS, (busy, unclear, unknown)),
            (_NETWORK, (busy, alone)),
        ):
            self._buttons[label].allow(next(filter(None, reasons), ""))

    def sound(self) -> None:
        """Play a sound, if that is wanted."""
        if self._sound.value:
            self._sounded += 1
            self._player.content = playing(self._sounded)

    def _connect(self) -> None:
        worker = self._worker
        self._go_on.on_click(lambda _: worker.answer(more=True))
        self._enough.on_click(lambda _: worker.answer(more=False))
        self._name.on_update(lambda _: worker.change(name=plain_name(self._name.value)))
        self._captures.on_update(lambda _: worker.change(captures=int(self._captures.value)))

    @staticmethod
    def _bind(gui: viser.GuiApi, label: str, key: str, action: Callable[[], object], hint: str) -> HintedButton:
        gui.add_command(label, hotkey=key, modifier="shift").on_trigger(lambda _: action())
        return HintedButton(gui, label, lambda _: action(), hint, main=label == _SCAN)

    def _toggle_live(self) -> None:
        live = self._worker.status.activity is Activity.LIVE
        self._worker.request(Activity.NOTHING if live else Activity.LIVE)
