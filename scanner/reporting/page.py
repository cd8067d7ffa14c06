"""report.html: one self-contained page that says whether a result can be trusted, and shows why."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from calib.finding import of_kinds
from calib.numerics import in_parallel
from calib.scene import BY_SCENE
from scanner.quantities import plain
from scanner.rendering import page
from scanner.reporting import sections
from scanner.reporting.contents import ReportInput
from scanner.reporting.focal import focal_length
from scanner.reporting.residuals import face_residuals, flatness, misses
from scanner.reporting.sections import FacesPicture, PageImage
from scanner.reporting.uncertainty import joint_rows, merged_views, point_sigmas
from scanner.reporting.verdict import verdict
from scanner.reporting.view3d import view3d
from scanner.results import CORNER

VIEWER = "viewer.js"


# The slow parts, the slowest first, so that none remains for the end. The first also measures the scene, which the
# verdict and the tables use.
PARTS: dict[str, Callable[[ReportInput], Any]] = {
    "flatness": flatness,
    "views": sections.cloud_views,
    "misses": misses,
    "faces": sections.faces,
    "sigmas": point_sigmas,
    "focal": focal_length,
    "merged": merged_views,
    "face_residuals": face_residuals,
    "depth": sections.depth,
    "view3d": view3d,
    "scene": sections.scene,
    "mask": lambda report: sections.mask(report.outcome.decoded.decoding),
    "capture": sections.capture_rows,
}


def write_report(path: Path, report: ReportInput) -> None:
    """Write the page. It needs no network and no other file.

    Raises OSError if the file cannot be written.
    """
    parts = dict(zip(PARTS, in_parallel(lambda part: part(report), PARTS.values()), strict=True))
    tables = sections.tables(report)
    solution, reconstructed = report.solution, report.reconstructed
    decision = verdict(report)
    text = page(
        "report.html",
        runs=VIEWER,
        **parts,
        subtitle=sections.subtitle(report.metadata),
        provenance=report.provenance,
        configuration=sections.configuration(report.provenance),
        verdict=decision,
        method=solution.method if solution else None,
        by_scene=bool(of_kinds(report.findings, BY_SCENE)),
        tables=tables,
        has_sigmas=any(row.sigma is not None for table in tables for row in table.rows),
        plain=plain,
        on_paper=[picture.on_paper for picture in _most_telling(**parts)],
        has_truth=report.truth is not None,
        photos=report.metadata.photos,
        captures=joint_rows(report),
        files=[(name, CORNER.files.get(name, "")) for name in report.files],
        unit=reconstructed.calibration.unit if reconstructed else "",
    )
    path.write_text(text, encoding="utf-8")


def _most_telling(
    views: Sequence[PageImage],
    merged: Sequence[PageImage],
    faces: FacesPicture | None,
    scene: PageImage | None,
    **_: object,
) -> list[PageImage]:
    """The pictures of the first printed page."""
    shown_scene = faces.picture if faces else scene
    return [*(merged or views)[:1], *([shown_scene] if shown_scene else [])]
