"""Check that there is enough memory to decode frames, before it is allocated."""

from pathlib import Path

from scanner.errors import InputError

# Peak use, with 16-bit frames and a match at every pixel; with codes only, edges and all pairs are kept as well.
_BYTES_PER_PIXEL, _OF_CODES_ALONE = 70, 136
_MEMINFO = Path("/proc/meminfo")


def require_memory(shape: tuple[int, int], kept_bytes: int, *, codes_alone: bool) -> None:
    """Raise InputError if decoding frames (H, W) takes more memory than is free.

    `kept_bytes`: memory of the kept frames. Does nothing where the system does not report its free memory.
    """
    needed = kept_bytes + shape[0] * shape[1] * (_OF_CODES_ALONE if codes_alone else _BYTES_PER_PIXEL)
    free = _stated_bytes("MemAvailable")
    if free is not None and needed > free:
        raise InputError(
            f"frames of {shape[1]} × {shape[0]} pixels take about {needed / 1e9:.1f} GB of memory to decode, and "
            f"{free / 1e9:.1f} GB are free: close other programs, or reduce the frames and the camera's size with them"
        )


def total_bytes() -> int | None:
    """Return the memory of the machine, None where the system does not report it."""
    return _stated_bytes("MemTotal")


def _stated_bytes(name: str) -> int | None:
    try:
        lines = _MEMINFO.read_text(encoding="ascii").splitlines()
    except OSError:  # not Linux
        return None
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith(f"{name}:")), None)
