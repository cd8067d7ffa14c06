"""How much of what a camera sends the system keeps until it is read."""

from pathlib import Path

_LIMIT = Path("/proc/sys/net/core/rmem_max")
# Packets count with all the memory that they lie in, and the reader may not be there in time.
_KEPT = 4


def receive_buffer(frame_bytes: int, limit: Path = _LIMIT) -> int | None:
    """Bytes to ask for, for a socket to keep a whole frame and more; None where the system does not give so many."""
    wanted = _KEPT * frame_bytes
    try:
        return wanted if int(limit.read_text()) >= wanted else None
    except (OSError, ValueError):  # not Linux, or not to be known
        return None
