"""A sound for an operator who does not look at the page."""

import base64
import wave
from functools import cache
from io import BytesIO

import numpy as np

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
