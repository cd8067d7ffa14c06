"""A plugin of pytest that writes down which functions of the repository each test calls, for `tools/mutate.py`.

    python -m pytest -p tools.called_functions tests

One JSON line for each test: its name, its seconds, and the functions as `path:qualified name`; a module's own code is
`path:<module>`. Tests that are in the file already are left out, so that a run can be interrupted and continued. What a
fixture calls belongs to every test that uses it. Machine code calls nothing that Python would notice.
"""

import json
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FrameType

import pytest

ROOT = Path(__file__).parents[1]
RECORD_FILE = ROOT / ".called_functions.jsonl"

_called: set[CodeType] = set()
_by_fixture: dict[object, set[CodeType]] = {}


def _note(frame: FrameType, _event: str, _argument: object) -> None:
    """The trace function of every thread: is asked at each call, and wants to know nothing of its lines."""
    _called.add(frame.f_code)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Where to write."""
    parser.addoption("--called-functions", type=Path, default=RECORD_FILE, help="default: %(default)s")


def pytest_configure() -> None:
    """Begin before anything of the repository is imported."""
    threading.settrace(_note)
    sys.settrace(_note)


def pytest_unconfigure() -> None:
    """End before the interpreter takes the module apart."""
    threading.settrace(None)
    sys.settrace(None)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is recorded."""
    record = config.getoption("--called-functions")
    lines = record.read_text(encoding="utf-8").splitlines() if record.is_file() else []
    recorded = {json.loads(line)["test"] for line in lines}
    items[:] = [item for item in items if item.nodeid not in recorded]


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: pytest.FixtureDef[object]) -> Iterator[None]:
    """Keep what a fixture calls that later tests get without a call."""
    before = set(_called)
    _called.clear()
    try:
        return (yield)
    finally:
        _by_fixture[fixturedef] = set(_called)
        _called.update(before)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Write the line of a test."""
    _called.clear()
    sys.settrace(_note)
    start_s = time.perf_counter()
    result = yield
    seconds = time.perf_counter() - start_s
    codes = set(_called)
    info = getattr(item, "_fixtureinfo", None)
    for definitions in info.name2fixturedefs.values() if info else ():
        for definition in definitions:
            codes |= _by_fixture.get(definition, set())
    entry = {
        "test": item.nodeid,
        "seconds": round(seconds, 2),
        "functions": sorted({name for code in codes if (name := _named(code))}),
    }
    with item.config.getoption("--called-functions").open("a", encoding="utf-8") as file:
        file.write(json.dumps(entry) + "\n")
    return result


def _named(code: CodeType) -> str | None:
    """`path:qualified name` of a function of the product; comprehensions and lambdas are part of theirs."""
    path = Path(code.co_filename)
    if not path.is_relative_to(ROOT):
        return None
    parts = path.relative_to(ROOT).parts
    if parts[0] not in ("calib", "hw", "scanner"):
        return None
    name = code.co_qualname.split(".<locals>.<")[0]
    return f"{'/'.join(parts)}:{'<module>' if name.startswith('<') else name}"
