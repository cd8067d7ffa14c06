"""The camera and the projector of a simulated room."""

import numpy as np

from calib.geometry import SQUARE_PIXELS, PixelGrid
from calib.numerics import Image
from hw.errors import DeviceError
from hw.rig import Capabilities, Frame
from hw.simulated.arrays import Light
from hw.simulated.illumination import Lamp
from hw.simulated.renderer import Renderer
from hw.simulated.simulation import SimulatedRoom
from hw.simulated.things import SimulatedThing, ThingRenderer

# Streams of random numbers of the camera; the room uses others.
_NOISE_STREAM = 101
_PULSE_STREAM = 102

_EXPOSURE_LIMITS_US = (10.0, 1e7)


View = Renderer | ThingRenderer
Scenery = SimulatedRoom | SimulatedThing


class SimulatedProjector:
    """Lights the room with the picture that it shows; black at first.

    `grid`: what its pixels are taken for; what they are is a setting of the room's. In both grids it has as many.
    """

    def __init__(self, room: Scenery, grid: PixelGrid = SQUARE_PIXELS) -> None:
        self._room, self._grid = room, grid
        optics = room.room.projector.optics
        self._size = grid.square_size(room.settings.grid.device_size((optics.width, optics.height)))
        width, height = self.size
        self._shown = self._linear(np.zeros((height, width), np.uint8))
        self._light = self._shown

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in square pixels, if the grid is what it is taken for."""
        return self._size

    @property
    def light(self) -> Light:
        """Linear light of its pixels now, (H, W); 1 is white."""
        return self._light

    def show(self, image: Image) -> None:
        """Light the room with an (H, W) 8-bit grey image. Raises ValueError if it has another size or type."""
        width, height = self.size
        if image.shape != (height, width) or image.dtype != np.uint8:
            raise ValueError(
                f"the projector shows 8-bit grey images of {width} × {height} pixels, "
                f"found {image.dtype} of the shape {image.shape}"
            )
        before, self._shown = self._shown, self._linear(image)
        ghost = np.float32(self._room.settings.ghost)
        self._light = self._shown if ghost == 0 else (1 - ghost) * self._shown + ghost * before

    def _linear(self, image: Image) -> Light:
        light: Light = self._room.renderer.picture.linear(self._room.settings.grid.spread(self._grid.sample(image)))
        return light


class SimulatedCamera:
    """Sees the room in the light of the projector. The noise of each frame is independent."""

    def __init__(self, room: Scenery, projector: SimulatedProjector) -> None:
        self._room = room
        self._projector = projector
        settings = room.settings
        place = [settings.thing.camera_place, settings.thing.projector_place]
        self._noise = np.random.default_rng(
            [settings.seed, _NOISE_STREAM, settings.pose, *(place if any(place) else ())]
        )
        pulses = np.random.default_rng([room.settings.seed, _PULSE_STREAM, room.settings.pose])
        self._lamp = Lamp(room.settings, pulses)
        self._exposure_us = room.sensor.exposure_us
        self._frame = 0
        self._seen: tuple[Light, View, Light] | None = None
        self._unlit: tuple[View, Light] | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        optics = self._room.room.camera.optics
        return optics.width, optics.height

    @property
    def capabilities(self) -> Capabilities:
        """The exposure can be set; frames wait for the projector."""
        return Capabilities(exposure="settable")

    @property
    def highest_level(self) -> int:
        """The largest value of a pixel."""
        return int(2**self._room.sensor.bit_depth - 1)

    @property
    def exposure_us(self) -> float:
        """The exposure of the next frames."""
        return self._exposure_us

    @property
    def exposure_limits_us(self) -> tuple[float, float]:
        """The shortest and the longest exposure, those of ordinary machine-vision cameras."""
        return _EXPOSURE_LIMITS_US

    def expose_for(self, exposure_us: float) -> float:
        """Set the exposure of the next frames. Raises DeviceError outside the limits."""
        shortest, longest = _EXPOSURE_LIMITS_US
        if not shortest <= exposure_us <= longest:
            raise DeviceError(
                f"the simulated camera exposes for {shortest:.0f} to {longest:.0f} µs, not for {exposure_us:.0f}"
            )
        self._exposure_us = exposure_us
        return exposure_us

    def grab(self) -> Frame:
        """One frame of the room in the light that the projector shows now."""
        sensor = self._room.sensor
        projected, unlit = self._expected()
        lamp = self._lamp.brightness(self._exposure_us, len(projected))
        electrons = projected * lamp + unlit * np.float32(self._room.ambient_level(self._frame))
        electrons *= np.float32(self._exposure_us / sensor.exposure_us)
        self._frame += 1
        return Frame(sensor.read(electrons, self._noise), exposure_us=self._exposure_us)

    def _expected(self) -> tuple[Light, Light]:
        """Electrons (H, W) at the sensor's exposure: from the projector, and from ambient light at a level of one.

        The last picture's electrons are kept for the next frame of it.
        """
        light, renderer, sensor = self._projector.light, self._room.at(self._frame), self._room.sensor
        if self._seen is None or self._seen[0] is not light or self._seen[1] is not renderer:
            self._seen = light, renderer, sensor.electrons(renderer.projected(light))
        if self._unlit is None or self._unlit[0] is not renderer:
            self._unlit = renderer, sensor.electrons(renderer.room_light)
        return self._seen[2], self._unlit[1]
