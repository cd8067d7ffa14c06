"""The page's network: who sees whose light, each camera's last picture, and how far each projector is."""

import time
from collections.abc import Callable
from threading import Lock

import viser

from hw.rig import Frame
from scanner.console.picture import shown
from scanner.console.progress import ProgressStep
from scanner.console.settings import ConsoleSettings
from scanner.console.texts import failures_html, pictures_html, stages_html
from scanner.console.worker import Activity, Status
from scanner.errors import InputError
from scanner.networks import Pair, PairProgress, in_light, network_graph
from scanner.rendering import jpeg_uri

_EVERY_S = 0.3
_LONGEST_SIDE = 320
_BYTE = 255
_IN_TURN = "all cameras, in turn"


class NetworkView:
    """A folder in the container that is open when it is made, to be seen where the configuration names a network.

    `change` takes the settings that the operator changes, `on_network` whether there is a network. Called from several
    threads.
    """

    def __init__(self, gui: viser.GuiApi, change: Callable[..., None], on_network: Callable[[bool], None]) -> None:
        self._on_network = on_network
        self._lock = Lock()
        self._sights: dict[Pair, PairProgress] = {}
        self._began_s: dict[str, float] = {}
        self._pictures: dict[str, tuple[str, str]] = {}  # by camera: what it shows, and a data URI
        self._levels: dict[str, int] = {}
        self._drawn_s: dict[str, float] = {}
        self._timed = False
        self._folder = gui.add_folder("Network", visible=False)
        with self._folder:
            self._graph = gui.add_html("")
            self._progress = gui.add_html("")
            self._images = gui.add_html("")
            self._pair = gui.add_dropdown("Look at", [_IN_TURN], hint="Also what Check, Scan and Live clouds take")
            self._distance = gui.add_text("Distance", "", hint="Between two devices, if known: left,stage,2.35m")
        self._pair.on_update(lambda _: change(pair=self._chosen, exposure_us=None, gain=None))
        self._distance.on_update(lambda _: change(distance=self._distance.value.strip()))

    def follow(self, settings: ConsoleSettings) -> None:
        """Show the network of the configuration as it is now; until that can be read, the last one."""
        try:
            rigs = settings.load_whole().rigs
        except InputError:
            return  # whoever needs it says so
        pairs = [] if rigs is None else [*rigs.pairs]
        with self._lock:
            if self._timed or pairs == [*self._sights]:
                return
            self._sights = {pair: PairProgress(*pair) for pair in pairs}
            self._began_s, self._pictures = {}, {}
            self._folder.visible = bool(pairs)
            self._draw()
        self._pair.options = (_IN_TURN, *(in_light(*pair) for pair in pairs))
        self._on_network(bool(pairs))
        if settings.pair is not None and settings.pair not in pairs:
            self._pair.value = _IN_TURN

    def show(self, status: Status) -> None:
        """Tell the time that is left for as long as there is any."""
        with self._lock:
            timed = status.activity is Activity.NETWORK
            if timed and not self._timed:
                self._sights, self._began_s = {}, {}  # those that are captured are about to be told
            if timed != self._timed:
                self._timed = timed
                self._draw()

    def tick(self) -> None:
        """Time goes by."""
        with self._lock:
            if self._timed:
                self._draw()

    def on_sight(self, sight: PairProgress, frame: Frame | None) -> None:
        """A capture has got on."""
        now_s = time.monotonic()
        with self._lock:
            self._sights[sight.camera, sight.projector] = sight
            if sight.done:
                self._began_s.setdefault(sight.projector, now_s)
            elif not sight.failure:
                self._began_s.pop(sight.projector, None)
            if frame is None or self._is_due("", now_s):
                self._draw()
        if frame is not None:
            self.on_frame(sight.camera, frame, sight.name)

    def on_frame(self, camera: str, frame: Frame, caption: str = "") -> None:
        """Show a camera's frame in small, unless its last one was shown a moment ago."""
        with self._lock:
            if not self._is_due(camera, time.monotonic()):
                return
            level = self._levels[camera] = max(self._levels.get(camera, _BYTE), int(frame.image.max()))
            picture = shown(frame.image, level, mark_clipped=False, longest_side=_LONGEST_SIDE)
            self._pictures[camera] = caption or camera, jpeg_uri(picture)
            names = dict.fromkeys(name for name, _ in self._sights)
            self._images.content = pictures_html(
                {name: self._pictures[name] for name in names if name in self._pictures}
            )

    @property
    def _chosen(self) -> Pair | None:
        return next((pair for pair in [*self._sights] if in_light(*pair) == self._pair.value), None)

    def _is_due(self, what: str, now_s: float) -> bool:
        due = now_s - self._drawn_s.get(what, 0.0) >= _EVERY_S
        if due:
            self._drawn_s[what] = now_s
        return due

    def _draw(self) -> None:
        sights = [*self._sights.values()]
        if not sights:
            return
        self._graph.content = f'<div class="scan-graph">{network_graph(sights)}</div>{failures_html(sights)}'
        self._progress.content = stages_html(self._stages(), timed=self._timed)

    def _stages(self) -> list[ProgressStep]:
        """Each projector's frames, as soon as there is one."""
        stages, most = [], max(sight.total for sight in self._sights.values())  # of those that have not begun
        for projector in dict.fromkeys(name for _, name in self._sights):
            sights = [sight for (_, name), sight in self._sights.items() if name == projector]
            done, total = sum(sight.done for sight in sights), sum(sight.total or most for sight in sights)
            stages.append(ProgressStep(projector, done, total, self._began_s.get(projector, time.monotonic())))
        return stages if self._began_s else []
