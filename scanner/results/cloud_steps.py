"""The steps that are done to a result's cloud, as a file in it; the cloud itself stays as it was measured."""

from collections.abc import Sequence
from pathlib import Path

from pydantic import Field

from scanner.configuration import MOST_STEPS, CloudStep
from scanner.io import Entry, flow_yaml, new_file, read_yaml, validate
from scanner.results.names import STEPS_FILE


class _StepsEntry(Entry):
    steps: tuple[CloudStep, ...] = Field(max_length=MOST_STEPS)


def read_steps(folder: Path) -> tuple[CloudStep, ...]:
    """Of a result, in their order; none without such a file. Raises InputError if it is malformed."""
    path = folder / STEPS_FILE
    return validate(_StepsEntry, read_yaml(path), str(path)).steps if path.is_file() else ()


def write_steps(folder: Path, steps: Sequence[CloudStep]) -> None:
    """Write them, in place of those that are there; without any, there is no file. Raises InputError, StorageError."""
    path = folder / STEPS_FILE
    if not steps:
        path.unlink(missing_ok=True)
        return
    lines = [f"  - {flow_yaml({step.name: step.parameter})}" for step in steps]
    with new_file(path, overwrite=True) as partial:
        partial.write_text("\n".join(["steps:", *lines]) + "\n", encoding="utf-8")
