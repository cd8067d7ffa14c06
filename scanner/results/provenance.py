"""Provenance of a page or a file, for readers years later."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from scanner.configuration import Config
from scanner.results.unfinished import published_name


@dataclass(frozen=True)
class Provenance:
    """The result's `name`, when it was `made` (UTC), by which `program`, and what its `configuration` sets."""

    name: str
    made: datetime
    program: str
    configuration: Mapping[str, Any]

    @property
    def date(self) -> str:
        """Date and time for reading."""
        return f"{self.made:%Y-%m-%d, %H:%M} UTC"

    def entries(self, devices: Mapping[str, str]) -> dict[str, Any]:
        """A key for a calibration file; `devices`: the capture's metadata."""
        return {
            "made": {
                "name": self.name,
                "date": self.made.isoformat(timespec="seconds"),
                "program": self.program,
                "configuration": {**self.configuration},
                "capture": {**devices},
            }
        }


def provenance(folder: Path, config: Config) -> Provenance:
    """Return the provenance of the result being made in `folder`, as of now."""
    settings = json.loads(config.as_json())
    return Provenance(published_name(folder), datetime.now(UTC), f"roomscan {version('roomscan')}", settings)
