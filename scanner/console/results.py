"""The results that earlier scans left."""

from pathlib import Path

from scanner.io import MATCHES_FILE
from scanner.results import CALIBRATION_FILE, LOG_FILE, NETWORK_FILE, OBJECT_FILE, REFUSAL_FILE, ROOM_FILE

SCANS = Path("scans")
_TO_SHOW = (MATCHES_FILE, ROOM_FILE, OBJECT_FILE, NETWORK_FILE, REFUSAL_FILE)


def earlier_results(folder: Path = SCANS) -> tuple[Path, ...]:
    """Result folders in `folder`, the newest first; refused captures too, for they say why."""
    try:
        logged = (path for path in folder.iterdir() if (path / LOG_FILE).is_file())
        results = [path for path in logged if any((path / name).is_file() for name in _TO_SHOW)]
    except OSError:
        return ()  # nothing was scanned yet
    return tuple(sorted(results, key=lambda path: ((path / LOG_FILE).stat().st_mtime, path.name), reverse=True))


def newest_result() -> Path | None:
    """The newest of them; None where there is none."""
    return next(iter(earlier_results()), None)


def newest_calibration() -> Path | None:
    """That of the newest result that has one; None where none has."""
    calibrations = (result / CALIBRATION_FILE for result in earlier_results())
    return next((path for path in calibrations if path.is_file()), None)
