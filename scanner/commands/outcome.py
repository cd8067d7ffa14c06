"""What a successful command tells: the calibration, how true it is, and where the files are."""

from pathlib import Path

from scanner.quantities import calibration_table, truth_line
from scanner.results import CALIBRATION_FILE, CLOUD_FILE, MERGED_FILE, REPORT_FILE, Scan
from scanner.ui import Terminal


def show_outcome(scan: Scan, out: Path, terminal: Terminal) -> None:
    """Print the summary of a result that was published at `out`."""
    newest = scan.newest
    if newest.calibration is None:
        raise ValueError("a refused capture has no outcome to show")
    terminal.show(calibration_table(newest.calibration, newest.truth))
    if newest.truth:
        terminal.show(truth_line(newest.calibration, newest.truth))
    for remark in scan.remarks:
        terminal.show(f"Note: {remark}")
    for title, found in zip(scan.titles, scan.captures, strict=True):
        pixels = "px" if found.facts.photos else "projector px"
        residual = "" if found.solution is None else f", residual {found.solution.residual_px:.3f} {pixels}"
        kept = found.cloud.statistics.kept if found.cloud else 0
        name = f"{title}: " if len(scan.captures) > 1 else ""
        terminal.show(f"{name}{len(found.matches):,} matches{residual}, {kept:,} points in the cloud")
    files = (REPORT_FILE, CLOUD_FILE, *((MERGED_FILE,) if scan.merged else ()), CALIBRATION_FILE)
    terminal.show(f"Result: {out} ({', '.join(files)})")
