"""A check as a folder: `check.yaml` with the rows, and the pictures."""

from pathlib import Path

import yaml

from scanner.checking.pictures import write_pictures
from scanner.checking.report import CheckReport
from scanner.patterns import FORMAT
from scanner.results import OutputFolder

CHECK_FILE = "check.yaml"


def write_check(out: Path, report: CheckReport) -> None:
    """Write the folder, whole or not at all. Raises InputError if it exists."""
    with OutputFolder(out) as output:
        document = {
            "format": FORMAT,
            "state": report.state.value,
            "exposure_us": report.exposure_us,
            "response": None if report.response is None else list(report.response),
            "rows": [
                {
                    "name": row.name,
                    "kind": row.finding.kind.name,
                    "state": row.state.value,
                    "finding": row.finding.message,
                    "advice": row.finding.advice,
                }
                for row in report.rows
            ],
            "pictures": write_pictures(output.folder, report.pictures),
        }
        text = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=120)
        (output.folder / CHECK_FILE).write_text(text, encoding="utf-8")
