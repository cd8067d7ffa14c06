"""Machine code in the cache folder is reused, and never for another source."""

import os
import shutil
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest
from numba.core import config

from calib.numerics import machine_code
from tests.support.places import ROOT

SOURCE = """
from calib.numerics.jit import compiled

OFFSET = {offset}

@compiled
def shifted(number):
    return number + OFFSET
"""


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(
        sys, "dont_write_bytecode", True
    )  # of sources that are as long as before, and of the same moment
    file = tmp_path / "installed" / "loops.py"
    file.parent.mkdir()
    file.write_text(SOURCE.format(offset=1))
    return file


@pytest.fixture
def caches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "caches"))
    return tmp_path / "caches"


def run(program: Path) -> tuple[float, bool]:
    """The result for 1 in a new process, and whether the function was compiled."""
    for remembered in (machine_code._digest, machine_code._note_use, machine_code._forget_unused):
        remembered.cache_clear()
    spec = spec_from_file_location("loops", program)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    found = module.shifted(1.0)
    return found, not module.shifted.dispatcher.stats.cache_hits


def kept(caches: Path) -> list[Path]:
    return sorted(caches.rglob("*.nbc"))


def test_code_is_cached_per_source(program: Path, caches: Path) -> None:
    assert [run(program), run(program)] == [(2.0, True), (2.0, False)]
    assert [path for path in program.parent.rglob("*") if path.suffix in (".nbi", ".nbc")] == []
    assert len(kept(caches)) == 1

    # As long as before, and of the same moment: only the content tells. Both are kept side by side.
    before = program.stat()
    for offset, compiled in ((2, True), (1, False), (2, False)):
        program.write_text(SOURCE.format(offset=offset))
        os.utime(program, ns=(before.st_atime_ns, before.st_mtime_ns))
        assert run(program) == (1.0 + offset, compiled)
    assert len(kept(caches)) == 2


def test_code_is_cached_per_option_version_and_processor(
    program: Path, caches: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(program)
    monkeypatch.setattr("calib.numerics.machine_code._ARITHMETIC", ("contract",))
    assert run(program) == (2.0, True)
    monkeypatch.setattr(machine_code, "_machine", lambda: "another one")
    assert run(program) == (2.0, True)
    assert len({path.parent for path in kept(caches)}) == 3


def test_a_copied_source_shares_the_cache(program: Path, caches: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(program.parent, copy)
    assert run(copy / program.name) == (2.0, True)
    shutil.rmtree(copy)
    assert not copy.exists()
    assert run(program) == (2.0, False)


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_damaged_entries_are_recompiled(program: Path, caches: Path, ending: str) -> None:
    run(program)
    (file,) = caches.rglob(f"*.{ending}")
    for damage in (b"", b"nonsense", file.read_bytes()[:-40]):
        file.write_bytes(damage)
        assert [run(program), run(program)] == [(2.0, True), (2.0, False)]


def test_code_of_another_function_with_the_same_name_is_not_used(program: Path, caches: Path) -> None:
    run(program)
    spec = spec_from_file_location("loops", program)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    module.shifted(1)
    of_float, of_whole = kept(caches)
    shutil.copyfile(of_whole, of_float)
    assert run(program) == (2.0, True)


def test_without_a_writable_folder_code_is_compiled_each_time(program: Path, caches: Path) -> None:
    caches.touch()  # a file, where a folder would have to be
    assert [run(program), run(program)] == [(2.0, True)] * 2


def test_entries_unused_for_long_are_deleted(program: Path, caches: Path) -> None:
    run(program)
    (used,) = {path.parent for path in kept(caches)}
    old = used.parent / "0123456789"
    old.mkdir()
    (old / "f.nbc").touch()
    for folder in (old, used):
        os.utime(folder, (1e9, 1e9))
    assert run(program) == (2.0, False)
    program.write_text(SOURCE.format(offset=3))
    run(program)
    assert used.exists()
    assert not old.exists()


def test_the_cache_is_in_the_users_cache_folder(program: Path, tmp_path: Path) -> None:
    caches = tmp_path / "of-the-user"
    environment = {"PYTHONPATH": f"{program.parent}:{ROOT}", "XDG_CACHE_HOME": str(caches)}
    command = [sys.executable, "-c", "import loops; print(loops.shifted(1.0))"]
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("2.0\n", "")
    (file,) = kept(caches)
    assert file.relative_to(caches).parts[:2] == ("roomscan", "machine-code")
