"""Flicker of the projector's lamp: its brightness in each row of a camera frame."""

import numpy as np

from hw.settings import SimulatedRigSettings
from hw.simulated.arrays import Light


class Lamp:
    """Light 1 + m cos(2πt + φ), with t in refresh periods. Every exposure begins at a random phase φ."""

    def __init__(self, settings: SimulatedRigSettings, rng: np.random.Generator) -> None:
        self._settings = settings
        self._rng = rng

    def brightness(self, exposure_us: float, rows: int) -> Light:
        """Brightness of the rows in the next frame, relative to the mean, (rows, 1)."""
        settings = self._settings
        if settings.pulsation == 0 and settings.flicker == 0:
            return np.ones((rows, 1), np.float32)
        # sinc is the mean of the cosine over an exposure of that many periods.
        periods = exposure_us / 1e6 * settings.refresh_hz
        swing = settings.pulsation * np.sinc(periods) + settings.flicker
        rolled = settings.rolling_shutter_ms / 1e3 * settings.refresh_hz
        phase = self._rng.uniform(0, 2 * np.pi) + 2 * np.pi * rolled * np.arange(rows) / rows
        return (1 + swing * np.cos(phase)).astype(np.float32)[:, None]
