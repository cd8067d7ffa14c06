"""A result's files: matches, clouds, calibration and report of every capture."""

import logging
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from calib.refusal import RefusalError
from scanner.io import MATCHES_FILE, write_calibration, write_matches, write_merged_ply, write_ply
from scanner.reporting import CaptureRow, ReportInput, verdict, write_report
from scanner.results import (
    CALIBRATION_FILE,
    CAPTURE_FOLDER,
    CLOUD_FILE,
    MERGED_FILE,
    REPORT_FILE,
    Findings,
    Scan,
    confidence_entries,
    folder_of,
)

log = logging.getLogger(__name__)

_ONE_OF_SEVERAL = (
    "This capture was calibrated together with others; what concerns all of them is in the report of the whole result, "
    "two folders up."
)


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
            written.append(pool.submit(write_matches, place / MATCHES_FILE, found.matches, found.plane))
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
