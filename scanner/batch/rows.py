"""The rows of a batch's table, each the outcome of one capture, and the table as files for other programs."""

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import get_args

from pydantic import TypeAdapter

from scanner.batch.location import Location
from scanner.errors import InputError
from scanner.results import Grade

ENDING = ".json"
_LARGEST = 2**63 - 1  # largest whole number of a table


@dataclass(frozen=True)
class BatchRow:
    """The outcome of one capture. `exit_code` is that of the equivalent single command; unknown values are None.

    `asked` identifies the request, including configuration and calibration. `seconds` is the time of work on `worker`,
    starting at `started` (UTC).
    """

    name: str
    capture: str
    result: str
    exit_code: int
    grade: str | None = None
    headline: str | None = None
    reason: str | None = None
    matches: int | None = None
    points: int | None = None
    residual_px: float | None = None
    camera_focal_px: float | None = None
    camera_focal_sigma_px: float | None = None
    projector_focal_px: float | None = None
    projector_focal_sigma_px: float | None = None
    projector_principal_point_x_px: float | None = None
    projector_principal_point_y_px: float | None = None
    projector_principal_point_sigma_px: float | None = None
    baseline: float | None = None
    unit: str | None = None
    asked: str = ""
    started: str = ""
    seconds: float = 0.0
    worker: str = ""

    def to_json(self) -> bytes:
        """Return the row as JSON."""
        return json.dumps(asdict(self), ensure_ascii=False, indent=1).encode()

    @staticmethod
    def from_json(data: bytes, where: str) -> "BatchRow":
        """Read a row from JSON. Raises InputError if it is not one."""
        try:
            row = _CHECKED.validate_json(data, strict=True)
            if row.grade not in (None, *get_args(Grade)) or any(
                isinstance(value, int) and abs(value) > _LARGEST for value in asdict(row).values()
            ):
                raise ValueError("beyond the values of a table")
            return row
        except ValueError as error:
            raise InputError(f"{where}: expected a row of a batch, found something else; remove it") from error


_CHECKED = TypeAdapter(BatchRow)


_COLUMNS = tuple(field.name for field in fields(BatchRow))


def write_csv(place: Location, rows: Sequence[BatchRow]) -> None:
    """A line for each row, after one with the columns' names. Raises OSError."""
    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in rows)
    place.write(text.getvalue().encode())


def write_parquet(place: Location, rows: Sequence[BatchRow]) -> None:
    """The same with types, empty columns included. Raises OSError."""
    import pyarrow
    import pyarrow.parquet

    kinds = {"str": pyarrow.string(), "int": pyarrow.int64(), "float": pyarrow.float64()}
    schema = pyarrow.schema(
        [
            pyarrow.field(field.name, kinds[str(getattr(field.type, "__name__", field.type)).split(" ")[0]])
            for field in fields(BatchRow)
        ]
    )
    columns = {name: [getattr(row, name) for row in rows] for name in _COLUMNS}
    sink = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(columns, schema=schema), sink)
    place.write(sink.getvalue())
