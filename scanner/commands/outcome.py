"""What a successful command tells: the calibration, how true it is, and where the files are."""

from pathlib import Path

from scanner.findings import Findings
from scanner.summary import calibration_table, truth_line
from scanner.terminal import Terminal


def show_outcome(found: Findings, out: Path, terminal: Terminal) -> None:
    """Print the summary of a result that was published at `out`."""
    if found.calibration is None or found.cloud is None:
        raise ValueError("a refused capture has no outcome to show")
    terminal.show(calibration_table(found.calibration, found.truth))
    if found.truth:
        terminal.show(truth_line(found.calibration, found.truth))
    for remark in found.remarks:
        terminal.show(f"Note: {remark}")
    residual = "" if found.solution is None else f", residual {found.solution.residual_px:.3f} projector px"
    terminal.show(
        f"{len(found.matches):,} matches{residual}, {found.cloud.statistics.kept:,} points in the cloud",
        f"Result: {out} (report.html, cloud.ply, calibration.yaml)",
    )
