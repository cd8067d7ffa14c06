"""What frames that were taken out of a film lack beside those of a camera that delivers every picture as it sees it."""

from collections.abc import Mapping
from math import hypot

# As `scan import` writes it of a film; in it, by what the film's coordinates err smoothly, in projector pixels.
RECORDING_KEY, SMOOTH_KEY = "recording", "smooth_px"
# By what factor smooth errors are larger in a film that does not say by what: of codes without fringes.
_UNKNOWN = 4.0


def with_smooth_errors_of_film(smooth_px: float, metadata: Mapping[str, object]) -> float:
    """Smooth errors of a capture's coordinates that are `smooth_px` in single frames, by its metadata."""
    recording = metadata.get(RECORDING_KEY)
    if not isinstance(recording, Mapping):
        return smooth_px
    of_film = recording.get(SMOOTH_KEY)
    if isinstance(of_film, float | int) and 0 <= of_film < 1:
        return hypot(smooth_px, of_film)
    return _UNKNOWN * smooth_px
