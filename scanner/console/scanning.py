"""A scan from the console: what `scan --config` does."""

from pathlib import Path

from scanner import pipeline
from scanner.console.settings import Settings
from scanner.reconstruction import read_captures, refuse_impossible
from scanner.results import Scan, default_out, new_result
from scanner.ui import Progress


def scan(settings: Settings, progress: Progress) -> Path:
    """Scan into a new folder in scans/, and return it. Raises InputError, DeviceError, RefusalError.

    What `progress` raises ends it, too; as after Ctrl-C, what was captured so far is kept.
    """
    config = settings.load()
    config.principal_point(config.camera_size)
    earlier = read_captures(config.earlier, config.camera_size, config.projector_size)
    refuse_impossible(config, len(earlier) + 1)
    out = default_out(settings.config.stem, overwrite=False)
    with new_result(out, config, overwrite=False, keep_capture=True) as folder:
        taken = pipeline.take(config.required_rig, config, folder, progress)
        taken.name = f"Capture {len(earlier) + 1}"
        pipeline.reconstruct(Scan([*earlier, taken]), config, folder, progress)
    return out
