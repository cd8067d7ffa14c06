"""Process one capture of a batch, on any worker: a result, a picture, a row."""

import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2

from calib.geometry import Calibration
from calib.numerics import use_processors
from scanner import jobs
from scanner.batch.listing import BatchJob
from scanner.batch.location import Location
from scanner.batch.rows import ENDING, BatchRow
from scanner.capture import open_capture
from scanner.errors import InputError, is_of_the_disk
from scanner.io import read_image
from scanner.rendering import encode_jpeg, photograph
from scanner.results import CALIBRATION_FILE, LOG_FILE, Scan, verdict_of
from scanner.ui import failure_of

RESULTS, ROWS, THUMBNAILS = "results", "rows", "thumbnails"
_THUMBNAIL_PX = 240


@dataclass(frozen=True)
class Delivery:
    """The destination of a batch: result folders, rows and pictures, each named after its capture."""

    out: str

    def result(self, name: str) -> Location:
        """A result folder; not there for input that is no capture."""
        return Location(self.out) / RESULTS / name

    def row(self, name: str) -> Location:
        """The location of the table's row, which is written last: if it exists, everything else does."""
        return Location(self.out) / ROWS / f"{name}{ENDING}"

    def thumbnail(self, name: str) -> Location:
        """A small camera image; missing if nothing can be read."""
        return Location(self.out) / THUMBNAILS / f"{name}.jpg"


Work = Callable[[BatchJob, Delivery], BatchRow]


def work(job: BatchJob, delivery: Delivery) -> BatchRow:
    """Reconstruct a capture and deliver the result, the row last. Every capture gets a row.

    Raises StorageError, OSError if nothing can be delivered, because that is no property of the capture.
    """
    _use_one_processor()
    started, began_s = datetime.now(UTC), time.monotonic()
    row = _reconstruct(job, delivery)
    row = replace(
        row,
        asked=job.asked,
        started=started.isoformat(timespec="seconds"),
        seconds=round(time.monotonic() - began_s, 3),
        worker=socket.gethostname(),
    )
    delivery.row(job.name).write(row.to_json())
    return row


def _reconstruct(job: BatchJob, delivery: Delivery) -> BatchRow:
    place = delivery.result(job.name)
    row = BatchRow(job.name, job.capture, place.url, 0)
    try:
        with Location(job.capture).fetched() as capture:
            _deliver_thumbnail(capture, delivery.thumbnail(job.name))
            if place.local is None:
                _make_room(place)
            with place.delivered() as out:
                try:
                    scan = _replay(job, capture, out)
                finally:
                    row = _with_verdict(row, out)
                return _of_scan(row, scan)
    except Exception as error:
        if is_of_the_disk(error):
            raise
        failure = failure_of(error)
        return replace(row, exit_code=failure.exit_code, reason=row.reason or failure.message)


def _replay(job: BatchJob, capture: Path, out: Path) -> Scan:
    with TemporaryDirectory(prefix="roomscan-") as scratch:
        known = None
        if job.calibration is not None:
            known = Path(scratch) / CALIBRATION_FILE
            known.write_text(job.calibration, encoding="utf-8")
        return jobs.replay(capture, out, config=job.config, calibration=known, overwrite=True, keep_recording=False)


def _make_room(place: Location) -> None:
    """Remove an earlier folder in remote storage, which cannot be replaced at once: its request differs, or it is
    unfinished.
    """
    if not place.exists:
        return
    if not (place / LOG_FILE).exists:
        raise InputError(f"{place.url}: exists and is no result of an earlier batch, so it is not overwritten")
    place.remove()


def _with_verdict(row: BatchRow, out: Path) -> BatchRow:
    verdict = verdict_of(out)
    if verdict is None:
        return row
    reason = " ".join(part for part in (verdict.reasons[0], verdict.advice) if part)
    return replace(row, grade=verdict.grade, headline=verdict.headline, reason=reason)


def _of_scan(row: BatchRow, scan: Scan) -> BatchRow:
    newest = scan.newest
    row = _of_calibration(row, newest.calibration)
    return replace(
        row,
        matches=len(newest.decoded.matches),
        points=newest.cloud.statistics.kept,
        residual_px=newest.solution.residual_px if newest.solution else None,
    )


def _of_calibration(row: BatchRow, calibration: Calibration) -> BatchRow:
    camera, projector, sigma = calibration.camera, calibration.projector, calibration.sigma
    return replace(
        row,
        camera_focal_px=camera.focal_px[0],
        camera_focal_sigma_px=sigma.camera.focal_px[0] if sigma.camera.focal_px else None,
        projector_focal_px=projector.focal_px[0],
        projector_focal_sigma_px=sigma.projector.focal_px[0] if sigma.projector.focal_px else None,
        projector_principal_point_x_px=projector.principal_point_px[0],
        projector_principal_point_y_px=projector.principal_point_px[1],
        projector_principal_point_sigma_px=max(sigma.projector.principal_point_px or (0.0,)) or None,
        baseline=calibration.baseline,
        unit=calibration.unit,
    )


def _deliver_thumbnail(capture: Path, place: Location) -> None:
    """Deliver a thumbnail of the first frame, which is mostly white. An unreadable frame is left for the decoder to
    report.
    """
    try:
        recording = open_capture(capture)
        picture = photograph(read_image(recording.folder / recording.files[0]), _THUMBNAIL_PX)
    except (InputError, IndexError):
        return
    place.write(encode_jpeg(picture))


def _use_one_processor() -> None:
    """Use one processor: workers side by side would compete with each other's threads."""
    use_processors(1)
    cv2.setNumThreads(1)
