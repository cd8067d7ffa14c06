"""What is found out about captures, and the files that tell it."""

import logging
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from calib.arrays import Image, Ints
from calib.calibration import Calibration
from calib.matches import Matches
from calib.refusal import RefusalError
from calib.selfcalibration import SelfCalibration
from scanner.calibration_file import write_calibration
from scanner.cloud import Cloud
from scanner.confidence import confidence_entries
from scanner.decode import Decoding
from scanner.matches_file import MATCHES_FILE, write_matches
from scanner.merged_cloud import MergedCloud
from scanner.patterns import Axis
from scanner.ply import write_merged_ply, write_ply
from scanner.report import CaptureFacts, CaptureRow, ReportInput, write_report
from scanner.reporting.verdict import verdict
from scanner.result import CALIBRATION_FILE, CAPTURE_FOLDER, CLOUD_FILE, MERGED_FILE, REPORT_FILE, folder_of

log = logging.getLogger(__name__)

_ONE_OF_SEVERAL = (
    "This capture was calibrated together with others; what concerns all of them is in the report of the whole result, "
    "two folders up."
)
_NOT_ABOUT_DEVICES = {"format", "projector", "camera", "frames", "devices"}


@dataclass
class Findings:
    """Of one capture. Filled in step by step; what a refusal prevented stays None.

    `calibration` is the one in use, with its scale; `truth` is known of simulated rigs, and only for showing it. `name`
    says in messages which of several captures it is; `photograph` is the lit scene where nothing was decoded; `plane`
    (N,) is which plane each match is on, as of `Faces`, where the faces were found and not given.
    """

    facts: CaptureFacts
    matches: Matches
    decoding: Decoding | None = None
    solution: SelfCalibration | None = None
    calibration: Calibration | None = None
    cloud: Cloud | None = None
    truth: Calibration | None = None
    name: str = ""
    photograph: Image | None = None
    plane: Ints | None = None

    @property
    def texture(self) -> Image | None:
        """The camera's image of the lit scene."""
        return self.decoding.texture if self.decoding else self.photograph

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a person should know about the decoding and the calibration, in sentences."""
        return (*(self.decoding.warnings if self.decoding else ()), *(self.solution.notes if self.solution else ()))

    @property
    def only_axis(self) -> Axis | None:
        """The only axis along which the projector's coordinate was measured, if so."""
        return self.decoding.only_axis if self.decoding else None


@dataclass
class Scan:
    """Captures of one unchanged rig, oldest first; mostly it is only one."""

    captures: Sequence[Findings]
    merged: MergedCloud | None = None
    remarks_on_merging: tuple[str, ...] = ()

    @property
    def newest(self) -> Findings:
        """The capture that the result is about; the others help to calibrate it."""
        return self.captures[-1]

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a person should know about it, in sentences."""
        return (*self.newest.remarks, *self.remarks_on_merging)

    @property
    def titles(self) -> tuple[str, ...]:
        """The captures' numbers, as notes have them, and where they come from if they were not taken just now."""
        if self.newest.facts.photos:
            return tuple(found.name for found in self.captures)
        numbers = [f"Capture {number}" for number in range(1, len(self.captures) + 1)]
        return tuple(
            number if found.name in ("", number) else f"{number}: {found.name}"
            for number, found in zip(numbers, self.captures, strict=True)
        )

    @contextmanager
    def naming(self, found: Findings) -> Iterator[None]:
        """A RefusalError in the block says which of several captures it is about."""
        try:
            yield
        except RefusalError as refusal:
            if len(self.captures) == 1:
                raise
            raise RefusalError(f"{found.name}: {refusal.reason}", refusal.advice) from refusal


def set_aside(captures: Sequence[Findings], folder: Path) -> None:
    """Make room for the next capture: the last one's recording goes to its place among several, with its matches.

    Should the next one fail, what is needed to calibrate from those before it is on disk.
    """
    place = folder_of(folder, len(captures) - 1, len(captures) + 1)
    place.mkdir(parents=True)
    (folder / CAPTURE_FOLDER).rename(place / CAPTURE_FOLDER)
    write_matches(place / MATCHES_FILE, captures[-1].matches)


def save(scan: Scan, folder: Path, refusal: RefusalError | None = None) -> None:
    """Write every capture's files into its folder of a result; after a refusal no calibration and no cloud.

    Raises OSError.
    """
    for remark in scan.remarks:
        log.info(remark)
    places = [folder_of(folder, index, len(scan.captures)) for index in range(len(scan.captures))]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        written = []
        for place, found in zip(places, scan.captures, strict=True):
            place.mkdir(parents=True, exist_ok=True)
            written.append(
                pool.submit(write_matches, place / MATCHES_FILE, found.matches, found.plane, found.only_axis)
            )
            if refusal is None and found.calibration and found.cloud:
                written.append(pool.submit(write_ply, place / CLOUD_FILE, found.cloud))
        if scan.merged is not None and refusal is None:
            written.append(pool.submit(write_merged_ply, folder / MERGED_FILE, scan.merged))
        # The files are still being written while the reports that list them are made.
        for place, found in zip(places, scan.captures, strict=True):
            report = _report_input(scan, found, place, refusal)
            if report.calibration is not None:
                uncertainty = found.solution.uncertainty if found.solution else None
                more = confidence_entries(verdict(report), uncertainty)
                write_calibration(place / CALIBRATION_FILE, report.calibration, more)
            write_report(place / REPORT_FILE, report)
        for each in written:
            each.result()


def _report_input(scan: Scan, found: Findings, folder: Path, refusal: RefusalError | None) -> ReportInput:
    newest = found is scan.newest
    return ReportInput(
        capture=found.facts,
        matches=found.matches,
        decoding=found.decoding,
        solution=None if refusal else found.solution,
        calibration=None if refusal else found.calibration,
        cloud=None if refusal else found.cloud,
        refusal=refusal,
        truth=scan.newest.truth,
        warnings=found.decoding.warnings if found.decoding else (),
        files=_files(scan, found, folder, refusal),
        photograph=found.photograph,
        together=len(scan.captures),
        captures=_rows(scan) if newest and len(scan.captures) > 1 else (),
        merged=scan.merged if newest and not refusal else None,
        remarks=scan.remarks_on_merging if newest else (_ONE_OF_SEVERAL,),
    )


def _files(scan: Scan, found: Findings, folder: Path, refusal: RefusalError | None) -> tuple[str, ...]:
    """The names of what is in a capture's folder, or will be, beside the report."""
    names = {MATCHES_FILE, *(path.name for path in folder.iterdir())}
    if refusal is None and found.cloud:
        names |= {CALIBRATION_FILE, CLOUD_FILE}
    if refusal is None and found is scan.newest and scan.merged is not None:
        names.add(MERGED_FILE)
    return tuple(sorted(names - {REPORT_FILE}))


def _rows(scan: Scan) -> tuple[CaptureRow, ...]:
    count, result = len(scan.captures), Path()
    return tuple(
        CaptureRow(
            title,
            "" if found is scan.newest else (folder_of(result, index, count) / REPORT_FILE).as_posix(),
            len(found.matches),
            found.solution.residual_px if found.solution else None,
            found.cloud.statistics.decoder_px if found.cloud else None,
            found.cloud.statistics.kept if found.cloud else None,
        )
        for index, (title, found) in enumerate(zip(scan.titles, scan.captures, strict=True))
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
        "latency, from a flip to its light": _with_unit(measured.get("latency_ms"), "ms"),
        "frames dropped, and taken again": measured.get("retriggered_frames"),
        "time per frame": _with_unit(measured.get("ms_per_frame"), "ms"),
        "of it over exposure and latency": _with_unit(measured.get("overhead_percent"), "%"),
    }
    return {name: str(value) for name, value in rows.items() if value is not None}


def _with_unit(value: object, unit: str) -> str | None:
    return None if value is None else f"{value} {unit}"
