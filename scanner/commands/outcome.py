"""The summary after a successful command: the calibration, its accuracy, and where the files are."""

from pathlib import Path

from scanner.commands.command import is_enough
from scanner.errors import GradeError
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


def show_outcome(scan: Scan, out: Path, terminal: Terminal, required: str | None) -> None:
    """Print the summary of a result that was published at `out`, the most important last. Raises GradeError."""
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
        otherwise = f"scan view {out} shows it, scan measure {out} measures in it."
        conclude(verdict, otherwise, terminal, required, DECISIVE)


def conclude(
    verdict: Verdict, otherwise: str, terminal: Terminal, required: str | None, most: int | None = None
) -> None:
    """Print the grade, `most` of its reasons, the first of them, and what to do next: the advice, or `otherwise`.

    Raises GradeError if a better grade is `required`.
    """
    reasons = (f"  {reason}" for reason in verdict.reasons[:most])
    terminal.show(f"{verdict.sign} {verdict.headline}", *reasons, f"→ {verdict.advice or otherwise}")
    if not is_enough(verdict.grade, required):
        raise GradeError(f"the result is {verdict.grade}, and --require {required} asks for better; it is kept")
