"""The summary after a successful command: the calibration, its accuracy, and where the files are."""

from collections.abc import Iterator
from pathlib import Path

from scanner.quantities import calibration_table, truth_line
from scanner.results import (
    CALIBRATION_FILE,
    CLOUD_FILE,
    DECISIVE,
    MERGED_FILE,
    REPORT_FILE,
    Scan,
    Verdict,
    read_verdict,
    titles_of,
)
from scanner.ui import Terminal


def show_outcome(scan: Scan, out: Path, terminal: Terminal) -> None:
    """Print the summary of a result that was published at `out`, the most important last."""
    calibration, truth = scan.newest.calibration, scan.newest.decoded.metadata.truth
    terminal.show(calibration_table(calibration, truth))
    if truth:
        terminal.show(truth_line(calibration, truth))
    for finding in scan.findings:
        terminal.show(f"Note: {finding}")
    titles = titles_of([capture.decoded for capture in scan.captures])
    for title, capture in zip(titles, scan.captures, strict=True):
        pixels = capture.decoded.metadata.pixels
        residual = f", residual {capture.solution.residual_px:.3f} {pixels}" if capture.solution else ""
        name = f"{title}: " if len(scan.captures) > 1 else ""
        matches, points = len(capture.decoded.matches), capture.cloud.statistics.kept
        terminal.show(f"{name}{matches:,} matches{residual}, {points:,} points in the cloud")
    files = (REPORT_FILE, CLOUD_FILE, *((MERGED_FILE,) if scan.merged else ()), CALIBRATION_FILE)
    terminal.show(f"Result: {out} ({', '.join(files)})")
    if verdict := read_verdict(out / CALIBRATION_FILE):
        terminal.show(*conclusion(verdict, f"scan view {out} shows it, scan measure {out} measures in it.", DECISIVE))


def conclusion(verdict: Verdict, otherwise: str, most: int | None = None) -> Iterator[str]:
    """The grade, `most` of its reasons, the first of them, and what to do next: the advice, or `otherwise`."""
    yield f"{verdict.sign} {verdict.headline}"
    yield from (f"  {reason}" for reason in verdict.reasons[:most])
    yield f"→ {verdict.advice or otherwise}"
