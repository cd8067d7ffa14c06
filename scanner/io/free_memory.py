"""Checks for memory before any is taken."""

import resource
from pathlib import Path

from scanner.errors import InputError

_MEMINFO, _STATUS = Path("/proc/meminfo"), Path("/proc/self/status")


def require_memory(needed: int, what: str, remedy: str) -> None:
    """Raise InputError if `what` takes more memory than is free, with the `remedy` beside closing other programs.

    Does nothing where the system does not report its free memory.
    """
    free = free_bytes()
    if free is not None and needed > free:
        raise InputError(
            f"{what} take about {needed / 1e9:.1f} GB of memory, and {free / 1e9:.1f} GB are free: close other "
            f"programs, or {remedy}"
        )


def free_bytes() -> int | None:
    """The memory that this process can still get, None where the system does not report it."""
    free = _stated_bytes(_MEMINFO, "MemAvailable")
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    used = _stated_bytes(_STATUS, "VmSize")
    if limit == resource.RLIM_INFINITY or used is None:
        return free
    allowed = max(0, limit - used)
    return allowed if free is None else min(free, allowed)


def total_bytes() -> int | None:
    """The memory of the machine, None where the system does not report it."""
    return _stated_bytes(_MEMINFO, "MemTotal")


def _stated_bytes(file: Path, name: str) -> int | None:
    try:
        lines = file.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:  # not Linux
        return None
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith(f"{name}:")), None)
