"""A batch on one page: a picture and a line for each capture, to be filtered."""

from collections import Counter
from collections.abc import Sequence
from math import inf, isfinite
from urllib.parse import quote

from scanner.batch.location import Location
from scanner.batch.rows import BatchRow
from scanner.batch.work import RESULTS, THUMBNAILS
from scanner.quantities import Quantity
from scanner.rendering import page
from scanner.results import REPORT_FILE, SIGNS
from scanner.ui import EXIT_BUG, EXIT_INPUT, EXIT_REFUSED

_SCRIPT = "batch.js"
# More rows would be slow in a browser; the table has all.
_MOST_ROWS = 5_000
_WORDS = {0: "calibrated", EXIT_INPUT: "unusable input", EXIT_REFUSED: "refused", EXIT_BUG: "crashed"}


def write_page(place: Location, rows: Sequence[BatchRow]) -> None:
    """Write the page. It needs no network; it links to the results and to no other files. Raises OSError."""
    counts = Counter(_state(row) for row in rows)
    text = page(
        "batch.html",
        lines=[_line(row) for row in rows[:_MOST_ROWS]],
        total=len(rows),
        left_out=max(0, len(rows) - _MOST_ROWS),
        counts=sorted(counts.items()),
        runs=_SCRIPT,
    )
    place.write(text.encode())


def _line(row: BatchRow) -> dict[str, object]:
    name = quote(row.name)
    return {
        "name": row.name,
        "state": _state(row),
        "grade": row.grade or "refused",
        "headline": _headline(row),
        "reason": row.reason or "",
        "report": f"{RESULTS}/{name}/{REPORT_FILE}" if row.grade else None,
        "picture": f"{THUMBNAILS}/{name}.jpg" if row.exit_code != EXIT_BUG else None,
        "camera": _with_sigma(row.camera_focal_px, row.camera_focal_sigma_px),
        "projector": _with_sigma(row.projector_focal_px, row.projector_focal_sigma_px),
        "residual": "" if row.residual_px is None else f"{row.residual_px:.3f}",
        "seconds": f"{row.seconds:.1f}",
    }


def _headline(row: BatchRow) -> str:
    if row.headline is None:
        return _state(row).capitalize()
    return f"{SIGNS[row.grade or 'refused']} {row.headline}"


def _state(row: BatchRow) -> str:
    return _WORDS.get(row.exit_code, f"exit code {row.exit_code}")


def _with_sigma(value: float | None, sigma: float | None) -> str:
    if value is None or not isfinite(value):
        return ""
    known = sigma if sigma is not None and 0 < sigma < inf else None
    quantity = Quantity("", value, "px", known)
    return quantity.shown(value) + (f" ± {quantity.shown(known)}" if known else "")
