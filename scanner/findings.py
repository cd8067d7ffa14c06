"""What is found out about a capture, and the files that tell it."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from calib.calibration import Calibration
from calib.matches import Matches
from calib.refusal import RefusalError
from calib.selfcalibration import SelfCalibration
from scanner.calibration_file import write_calibration
from scanner.cloud import Cloud
from scanner.decode import Decoding
from scanner.matches_file import MATCHES_FILE, write_matches
from scanner.ply import write_ply
from scanner.report import CaptureFacts, ReportInput, write_report
from scanner.result import CALIBRATION_FILE, CLOUD_FILE, REPORT_FILE

log = logging.getLogger(__name__)

_NOT_ABOUT_DEVICES = {"format", "projector", "camera", "frames", "devices"}


@dataclass
class Findings:
    """Filled in step by step; what a refusal prevented stays None.

    `calibration` is the one in use, with its scale; `truth` is known of simulated rigs, and only for showing it.
    """

    facts: CaptureFacts
    matches: Matches
    decoding: Decoding | None = None
    solution: SelfCalibration | None = None
    calibration: Calibration | None = None
    cloud: Cloud | None = None
    truth: Calibration | None = None

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a person should know about the decoding and the calibration, in sentences."""
        return (*(self.decoding.warnings if self.decoding else ()), *(self.solution.notes if self.solution else ()))


def save(found: Findings, folder: Path, refusal: RefusalError | None = None) -> None:
    """Write everything into a folder; after a refusal neither calibration nor cloud. Raises OSError."""
    for remark in found.remarks:
        log.info(remark)
    write_matches(folder / MATCHES_FILE, found.matches)
    if refusal is None and found.calibration and found.cloud:
        write_calibration(folder / CALIBRATION_FILE, found.calibration)
        write_ply(folder / CLOUD_FILE, found.cloud)
    write_report(folder / REPORT_FILE, _report_input(found, folder, refusal))


def _report_input(found: Findings, folder: Path, refusal: RefusalError | None) -> ReportInput:
    return ReportInput(
        capture=found.facts,
        matches=found.matches,
        decoding=found.decoding,
        solution=None if refusal else found.solution,
        calibration=None if refusal else found.calibration,
        cloud=None if refusal else found.cloud,
        refusal=refusal,
        truth=found.truth,
        warnings=found.decoding.warnings if found.decoding else (),
        files=tuple(sorted(path.name for path in folder.iterdir())),
    )


def identity(metadata: Mapping[str, object]) -> dict[str, str]:
    """What a recording says about its devices and itself, as far as it fits on a line each."""
    devices = metadata.get("devices")
    named = {str(key): str(value) for key, value in devices.items()} if isinstance(devices, Mapping) else {}
    named |= _synchronisation(metadata.get("synchronisation"))
    others = {key: value for key, value in metadata.items() if key not in _NOT_ABOUT_DEVICES}
    return named | {key: str(value) for key, value in others.items() if not isinstance(value, Mapping | list)}


def _synchronisation(measured: object) -> dict[str, str]:
    """What a rig of real devices has written down about taking turns, as far as it did."""
    if not isinstance(measured, Mapping):
        return {}
    rows = {
        "frames taken again": measured.get("retriggered_frames"),
        "time per frame": _with_unit(measured.get("ms_per_frame"), "ms"),
        "of it over exposure and latency": _with_unit(measured.get("overhead_percent"), "%"),
    }
    return {name: str(value) for name, value in rows.items() if value is not None}


def _with_unit(value: object, unit: str) -> str | None:
    return None if value is None else f"{value} {unit}"
