"""What frames that were taken out of a film lack beside those of a camera that delivers every picture as it sees it."""

from collections.abc import Mapping

# As `scan import` writes it of a film.
RECORDING_KEY = "recording"
# By what factor smooth errors of coordinates are larger: cameras that film sharpen, and compression is coarsest where
# contrast is low, which shifts fringes alike over whole faces (benchmarks/bench_recordings.py).
_SMOOTH = 4.0


def smooth_of(metadata: Mapping[str, object]) -> float:
    """The factor of the smooth errors of a capture's coordinates, by what its recording says of itself."""
    return _SMOOTH if isinstance(metadata.get(RECORDING_KEY), Mapping) else 1.0
