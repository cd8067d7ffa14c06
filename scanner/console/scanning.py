"""A scan from the console: what `scan --config` does."""

from pathlib import Path

from scanner import pipeline
from scanner.console.settings import Settings
from scanner.reconstruction import read_captures, refuse_impossible
from scanner.results import default_out, new_result
from scanner.ui import Progress


def destination(settings: Settings) -> Path:
    """Where the next result goes: a new folder in scans/, of the name that was typed, or of the configuration's."""
    return default_out(settings.name or settings.config.stem, overwrite=False)


def scan(settings: Settings, out: Path, progress: Progress) -> None:
    """Scan into `out`. Raises InputError, DeviceError, RefusalError.

    What `progress` raises ends it, too; as after Ctrl-C, what was captured so far is kept.
    """
    config = settings.load()
    config.principal_point(config.camera_size)
    earlier = read_captures(config.earlier, config.camera_size, config.projector_size)
    refuse_impossible(config, len(earlier) + 1)
    with new_result(out, config, overwrite=False, keep_capture=True) as folder:
        taken = pipeline.take(config.required_rig, config, folder, progress, f"Capture {len(earlier) + 1}")
        pipeline.reconstruct([*earlier, taken], config, folder, progress)
