"""Size of the socket's receive buffer."""

from pathlib import Path

_LIMIT = Path("/proc/sys/net/core/rmem_max")
# The kernel counts overhead of packets too, and the reader may be late.
_KEPT = 4


def receive_buffer(frame_bytes: int, limit: Path = _LIMIT) -> int | None:
    """Bytes of a receive buffer that holds a whole frame with reserve; None if the system's limit is lower."""
    wanted = _KEPT * frame_bytes
    try:
        return wanted if int(limit.read_text()) >= wanted else None
    except (OSError, ValueError):  # not Linux, or not readable
        return None
