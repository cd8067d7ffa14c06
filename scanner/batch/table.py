"""A batch's rows as files for other programs."""

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict, fields

from scanner.batch.location import Location
from scanner.batch.rows import Row

_COLUMNS = tuple(field.name for field in fields(Row))


def write_csv(place: Location, rows: Sequence[Row]) -> None:
    """A line for each row, after one with the columns' names. Raises OSError."""
    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in rows)
    place.write(text.getvalue().encode())


def write_parquet(place: Location, rows: Sequence[Row]) -> None:
    """The same with types, empty columns included. Raises OSError."""
    import pyarrow
    import pyarrow.parquet

    kinds = {"str": pyarrow.string(), "int": pyarrow.int64(), "float": pyarrow.float64()}
    schema = pyarrow.schema(
        [
            pyarrow.field(field.name, kinds[str(getattr(field.type, "__name__", field.type)).split(" ")[0]])
            for field in fields(Row)
        ]
    )
    columns = {name: [getattr(row, name) for row in rows] for name in _COLUMNS}
    sink = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(columns, schema=schema), sink)
    place.write(sink.getvalue())
