"""The screens and cameras of real rigs, each opened once: any camera in the light of any projector."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any, Generic, Self, TypeVar

import numpy as np

from calib.geometry import SQUARE_PIXELS, PixelGrid
from hw.backends import backend_of
from hw.cameras import CameraDriver, OpenedCamera
from hw.errors import DeviceError
from hw.projector.process import ScreenProjector
from hw.rig import exposure_control, settable_exposure
from hw.settings import CameraRigSettings
from hw.timing.streaming import streamed
from hw.timing.synchronisation import synchronised
from hw.timing.timed_rig import TimedRig

# If neither screen nor configuration states the rate.
_USUAL_REFRESH_HZ = 60.0

Pair = tuple[str, str]  # the names of a camera and of a projector
Settings = TypeVar("Settings", covariant=True)


@dataclass(frozen=True)
class PairSettings(Generic[Settings]):
    """What is configured for a camera in a projector's light; sizes are (width, height) in pixels."""

    rig: Settings
    camera_size: tuple[int, int]
    projector_size: tuple[int, int]
    """In square pixels."""
    grid: PixelGrid = SQUARE_PIXELS
    """The projector's own pixels."""


RealPair = PairSettings[CameraRigSettings]


@dataclass(frozen=True)
class _Opened:
    """A camera, what was asked of it, and its exposure since then, if that is settable; `closing` closes it."""

    camera: OpenedCamera
    wanted: object
    exposure_us: float | None
    closing: ExitStack


class RealDevices:
    """All devices of some pairs, from opening to closing (a context manager).

    Raises DeviceError if one is missing, does not support its settings, or has two names.
    """

    def __init__(self, pairs: Mapping[Pair, RealPair]) -> None:
        self._pairs = pairs
        self._open = ExitStack()
        self._screens: dict[str, ScreenProjector] = {}
        self._cameras: dict[str, _Opened] = {}

    def __enter__(self) -> Self:
        with ExitStack() as opening:
            opening.push(self._open)
            # First: a missing library is reported before anything is shown.
            self._drivers: dict[str, CameraDriver] = {
                pair.rig.backend: backend_of(pair.rig).load() for pair in self._pairs.values()
            }
            for (_, projector), pair in self._pairs.items():
                if projector not in self._screens:
                    self._open_screen(projector, pair)
            for camera, projector in self._pairs:
                if camera not in self._cameras:
                    self._camera(camera, projector)
            opening.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def together(self, projector: str) -> list[list[str]]:
        """The cameras in a projector's light: all that are triggered together, each streaming one alone."""
        streaming = {
            camera: self._cameras[camera].camera.capabilities.streaming
            for camera, further in self._pairs
            if further == projector
        }
        triggered = [camera for camera, streams in streaming.items() if not streams]
        return ([triggered] if triggered else []) + [[camera] for camera, streams in streaming.items() if streams]

    @contextmanager
    def rig(self, projector: str, cameras: Sequence[str]) -> Iterator[TimedRig]:
        """Synchronise one group of `together` with a projector, while all others show black. Raises DeviceError."""
        for name, further in self._screens.items():
            if name != projector:
                further.show(np.zeros(further.size[::-1], np.uint8))
        screen, known_hz = self._screens[projector], self._known_hz(cameras[0], projector)
        refresh_hz = known_hz or _USUAL_REFRESH_HZ
        of_screen = {
            "projector": str(screen.screen),
            "renderer": screen.renderer,
            "refresh": f"{refresh_hz:.5g} Hz{'' if known_hz else ' (assumed: neither screen nor configuration says)'}",
        }
        opened: list[tuple[Any, dict[str, str]]] = []
        for name in cameras:
            camera, backend = self._camera(name, projector), self._pairs[name, projector].rig.backend
            opened.append((camera, {"backend": backend, **camera.identity, **of_screen}))
        (camera, identity), *further_cameras = opened
        rig: TimedRig
        if camera.capabilities.streaming:
            rig = streamed(screen, camera, identity, refresh_hz)
        else:
            rig = synchronised(screen, camera, identity, refresh_hz, further_cameras)
        try:
            yield rig
        finally:
            rig.stop()

    def _known_hz(self, camera: str, projector: str) -> float | None:
        return self._pairs[camera, projector].rig.refresh_hz or self._screens[projector].screen.refresh_hz

    def _open_screen(self, projector: str, pair: RealPair) -> None:
        opened = self._open.enter_context(ScreenProjector(pair.rig.screen, pair.projector_size, pair.grid))
        for name, further in self._screens.items():
            if further.screen == opened.screen:
                raise DeviceError(
                    f"projectors {name} and {projector} are both on {opened.screen}: set rig: {{screen: …}} of each to "
                    "its own; scan devices lists them"
                )
        self._screens[projector] = opened

    def _camera(self, name: str, projector: str) -> OpenedCamera:
        """Open a camera, and open it anew only where its settings differ in this projector's light. Its exposure is the
        first one again.
        """
        pair = self._pairs[name, projector]
        refresh_hz = self._known_hz(name, projector) or _USUAL_REFRESH_HZ
        wanted = pair.rig.model_copy(update={"screen": None, "refresh_hz": refresh_hz}), pair.camera_size
        if name in self._cameras:
            known = self._cameras[name]
            if known.wanted == wanted:
                if known.exposure_us is not None:
                    exposure_control(known.camera).expose_for(known.exposure_us)
                return known.camera
            known.closing.close()
        closing = self._open.enter_context(ExitStack())
        driver = self._drivers[pair.rig.backend]
        camera = closing.enter_context(driver.connect(pair.rig, pair.camera_size, refresh_hz))
        control = settable_exposure(camera)
        self._cameras[name] = _Opened(camera, wanted, control.exposure_us if control else None, closing)
        return camera
