"""Whether there is memory enough to decode frames of a size: asked before it is taken."""

from pathlib import Path

from scanner.errors import InputError

# At its highest, with 16-bit frames and a match at every pixel. Of codes alone edges and all pairs are kept as well.
_BYTES_PER_PIXEL, _OF_CODES_ALONE = 70, 152
_MEMINFO = Path("/proc/meminfo")


def require_memory(shape: tuple[int, int], kept_bytes: int, *, codes_alone: bool) -> None:
    """Raise InputError if frames (H, W), of which so many bytes are kept, take more memory than is free, where the
    system tells.
    """
    needed = kept_bytes + shape[0] * shape[1] * (_OF_CODES_ALONE if codes_alone else _BYTES_PER_PIXEL)
    free = _stated_bytes("MemAvailable")
    if free is not None and needed > free:
        raise InputError(
            f"frames of {shape[1]} × {shape[0]} pixels take about {needed / 1e9:.1f} GB of memory to decode, and "
            f"{free / 1e9:.1f} GB are free: close other programs, or reduce the frames and the camera's size with them"
        )


def total_bytes() -> int | None:
    """The memory of the machine, where the system tells."""
    return _stated_bytes("MemTotal")


def _stated_bytes(name: str) -> int | None:
    try:
        lines = _MEMINFO.read_text(encoding="ascii").splitlines()
    except OSError:  # not Linux
        return None
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith(f"{name}:")), None)
