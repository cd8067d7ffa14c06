"""A result's files: matches, clouds, calibration and report of every capture."""

import logging
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from calib.diagnostics import PoseErrors
from calib.finding import Finding, FindingKind, Severity, of_kinds
from calib.geometry import Calibration
from calib.pointcloud import MergedCloud
from calib.refusal import RefusalError
from scanner.configuration import Config
from scanner.decoding import TOO_DARK
from scanner.io import MATCHES_FILE, write_calibration, write_matches, write_merged_ply, write_ply, write_poses
from scanner.reporting import CaptureRow, JointCaptures, ReportInput, verdict, write_report
from scanner.results import (
    CALIBRATION_FILE,
    CAPTURE_FOLDER,
    CLOUD_FILE,
    MERGED_FILE,
    POSES_FILE,
    REFUSAL_FILE,
    REPORT_FILE,
    Decoded,
    Provenance,
    Reconstructed,
    Refused,
    Scan,
    Stage,
    confidence_entries,
    decoded_of,
    findings_on,
    folder_of,
    pose_error_entries,
    provenance,
    solution_of,
    titles_of,
    verdict_entries,
    write_refusal,
)

log = logging.getLogger(__name__)

# By which its priority, on Linux a thread's own, is lower: it then gets a third of a processor that is in use.
_PATIENCE = 5

ONE_OF_SEVERAL = FindingKind(
    "one-of-several",
    "This capture was calibrated together with others; what concerns all of them is in the report of the whole result.",
    data=("captures",),
)


def set_aside(captures: Sequence[Decoded], folder: Path) -> None:
    """Make room for the next capture: move the last one's recording to its place among several, with its matches.

    If the next one fails, everything needed to calibrate from the earlier ones is on disk.
    """
    place = folder_of(folder, len(captures) - 1, len(captures) + 1)
    place.mkdir(parents=True)
    (folder / CAPTURE_FOLDER).rename(place / CAPTURE_FOLDER)
    write_matches(place / MATCHES_FILE, captures[-1].matches)


class EarlyMatches:
    """Writes the matches of a result's only capture during its calibration, which does not change them; none if
    nothing is to be kept.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        # The calibration comes first; what it leaves of the processors is enough, because much of it runs on one.
        self._thread = ThreadPoolExecutor(1, "matches", initializer=os.nice, initargs=(_PATIENCE,))
        self._begun: tuple[Decoded, Future[None]] | None = None

    def __enter__(self) -> "EarlyMatches":
        return self

    def __exit__(self, *_: object) -> None:
        self._thread.shutdown()

    def begin(self, captures: Sequence[Decoded]) -> None:
        """Write them, if it is one capture."""
        if self._folder is not None and len(captures) == 1:
            (alone,) = captures
            self._begun = alone, self._thread.submit(_write_matches, self._folder, alone)

    def write(self, place: Path, capture: Decoded) -> None:
        """Return when a capture's matches are in its folder of the result. Raises OSError."""
        if self._begun is not None and place == self._folder:
            begun, writing = self._begun
            writing.result()
            if begun.matches is capture.matches and begun.plane is capture.plane:
                return
        _write_matches(place, capture)


def _write_matches(place: Path, capture: Decoded) -> None:
    write_matches(place / MATCHES_FILE, capture.matches, capture.plane, capture.only_axis)


@contextmanager
def refusal_saved(
    captures: Sequence[Decoded], folder: Path | None, config: Config, matches: EarlyMatches | None = None
) -> Iterator[list[Stage]]:
    """Yield a list in which the block notes the stage of each capture.

    After a RefusalError in the block, these stages are written into a result folder, if there is one, without
    calibration or cloud.
    """
    reached: list[Stage] = [*captures]
    try:
        yield reached
    except RefusalError as refusal:
        named = _refused_for_darkness(refusal, [decoded_of(stage) for stage in reached])
        _log(findings_on(reached[-1]))
        if folder is not None:
            _save([Refused(stage, named) for stage in reached], folder, provenance(folder, config), matches)
        if named is refusal:
            raise
        raise named from refusal


def _refused_for_darkness(refusal: RefusalError, captures: Sequence[Decoded]) -> RefusalError:
    """The refusal; if a capture is nearly black, a refusal for that, because it may cause any other."""
    for capture in captures:
        for dark in of_kinds(capture.decoding.findings if capture.decoding else (), TOO_DARK):
            which = f"{capture.name}: " if len(captures) > 1 else ""
            reason = f"{which}{dark.message} What came of it: {refusal.reason}"
            return RefusalError(TOO_DARK, reason, dark.advice, dark.data)
    return refusal


def save(scan: Scan, folder: Path, config: Config, matches: EarlyMatches | None = None) -> None:
    """Write every capture's files into its folder of a result. Raises OSError."""
    _log(scan.findings)
    _save(scan.captures, folder, provenance(folder, config), matches, scan.merged, scan.own_findings)


def _log(findings: tuple[Finding, ...]) -> None:
    for finding in findings:
        log.info("%s: %s", finding.kind.name, finding)


def _save(
    captures: Sequence[Reconstructed | Refused],
    folder: Path,
    made: Provenance,
    matches: EarlyMatches | None,
    merged: MergedCloud | None = None,
    own_findings: tuple[Finding, ...] = (),
) -> None:
    """Write the stage of each capture; `merged` and `own_findings` are on the page of the newest one."""
    count, truth = len(captures), captures[-1].decoded.metadata.truth
    write = _write_matches if matches is None else matches.write
    places = [folder_of(folder, index, count) for index in range(count)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        written = []
        for place, capture in zip(places, captures, strict=True):
            place.mkdir(parents=True, exist_ok=True)
            written.append(pool.submit(write, place, capture.decoded))
            if isinstance(capture, Reconstructed):
                written.append(pool.submit(write_ply, place / CLOUD_FILE, capture.cloud, match=capture.cloud.match))
        if merged is not None:
            written.append(pool.submit(write_merged_ply, folder / MERGED_FILE, merged))
            write_poses(folder / POSES_FILE, merged.from_cameras, _pose_errors(captures, merged))
        # The files are still being written while the reports list them.
        joint = JointCaptures(count, findings=(_one_of(count),))
        for place, capture in zip(places[:-1], captures[:-1], strict=True):
            _write_report(place, capture, joint, truth, made)
        rows = _rows(captures) if count > 1 else ()
        _write_report(folder, captures[-1], JointCaptures(count, rows, merged, own_findings), truth, made)
        for task in written:
            task.result()


def _pose_errors(captures: Sequence[Reconstructed | Refused], merged: MergedCloud) -> dict[str, Any]:
    """Keys with the errors of the cameras' poses in the merged cloud; none where the method knows none."""
    newest = captures[-1]
    solution = None if isinstance(newest, Refused) else solution_of(newest)
    if solution is None or solution.corners_covariance is None:
        return {}
    # A corner that rotates and shifts before its camera moves the points of that capture the other way.
    motions = []
    for pose in merged.from_cameras:
        turned, moved = -pose.rotation, -float(np.linalg.norm(pose.inverse().translation)) * pose.rotation
        motions.append(scipy.linalg.block_diag(turned, moved))
    errors = PoseErrors.from_joint(solution.corners_covariance, motions)
    return pose_error_entries(errors, solution.calibration.pose.translation)


def _one_of(count: int) -> Finding:
    message = (
        "This capture was calibrated together with others; what concerns all of them is in the report of the whole "
        "result, two folders up."
    )
    return Finding(ONE_OF_SEVERAL, Severity.NOTE, message, data={"captures": tuple(range(1, count + 1))})


def _write_report(
    folder: Path, capture: Reconstructed | Refused, joint: JointCaptures, truth: Calibration | None, made: Provenance
) -> None:
    """A capture's report, and its calibration with the conclusions of the report."""
    # Names of unfinished files begin with a dot.
    files = {MATCHES_FILE, *(path.name for path in folder.iterdir() if not path.name.startswith("."))}
    if isinstance(capture, Refused):
        files.add(REFUSAL_FILE)
    if isinstance(capture, Reconstructed):
        files |= {CALIBRATION_FILE, CLOUD_FILE, *((MERGED_FILE, POSES_FILE) if joint.merged is not None else ())}
    report = ReportInput(capture, truth, tuple(sorted(files - {REPORT_FILE})), joint, made)
    write_report(folder / REPORT_FILE, report)
    entries = made.entries(capture.decoded.metadata.identity)
    if isinstance(capture, Reconstructed):
        more = entries | confidence_entries(verdict(report), capture.uncertainty)
        write_calibration(folder / CALIBRATION_FILE, capture.calibration, more)
    else:
        write_refusal(folder / REFUSAL_FILE, entries | verdict_entries(verdict(report)))


def _rows(captures: Sequence[Reconstructed | Refused]) -> tuple[CaptureRow, ...]:
    titles, count = titles_of([capture.decoded for capture in captures]), len(captures)
    rows = []
    for index, (title, capture) in enumerate(zip(titles, captures, strict=True)):
        stage = capture.reached if isinstance(capture, Refused) else capture
        address = "" if index == count - 1 else (folder_of(Path(), index, count) / REPORT_FILE).as_posix()
        solution, matches = solution_of(stage), len(capture.decoded.matches)
        residual_px = solution.residual_px if solution else None
        of_cloud = (stage.cloud.statistics, stage.calibration) if isinstance(stage, Reconstructed) else (None, None)
        rows.append(CaptureRow(title, address, matches, residual_px, *of_cloud))
    return tuple(rows)
