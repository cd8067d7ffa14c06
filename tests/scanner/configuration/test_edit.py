"""Single keys of a configuration are changed; everything else in the file stays."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from scanner.configuration.edit import set_keys, with_key
from scanner.configuration.schema import load_config
from scanner.errors import InputError


@dataclass(frozen=True)
class Case:
    name: str
    before: str
    after: str


CASES = [
    Case("block, key is there", "rig:\n  exposure_us: 1 # slow\n  a: 2\n", "rig:\n  exposure_us: 5.5 # slow\n  a: 2\n"),
    Case(
        "block, key is not there", "# top\nrig:\n  # in\n  a: 2\n", "# top\nrig:\n  # in\n  exposure_us: 5.5\n  a: 2\n"
    ),
    Case("four spaces", "rig:\n    a: 2\n", "rig:\n    exposure_us: 5.5\n    a: 2\n"),
    Case("flow", "rig: {a: 2}  # x\nb: 1\n", "rig: {a: 2, exposure_us: 5.5}  # x\nb: 1\n"),
    Case("flow, key is there", "rig: {exposure_us: 1, a: 2}\n", "rig: {exposure_us: 5.5, a: 2}\n"),
    Case("flow over lines", "rig: {\n  a: [1, 2] # x\n}\n", "rig: {\n  a: [1, 2], exposure_us: 5.5 # x\n}\n"),
    Case("no section", "b: 1", "b: 1\nrig:\n  exposure_us: 5.5\n"),
    Case("carriage returns", "rig:\r\n  a: 2\r\n", "rig:\r\n  exposure_us: 5.5\r\n  a: 2\r\n"),
    Case("a list is replaced", "rig:\n  exposure_us: [1,\n    2]\n  a: 2\n", "rig:\n  exposure_us: 5.5\n  a: 2\n"),
    Case(
        "a block list",
        "rig:\n  exposure_us:\n    - 1\n  # x\n  a: 2\n",
        "rig:\n  exposure_us:\n    5.5\n  # x\n  a: 2\n",
    ),
    Case("quotes", "'rig':\n  \"exposure_us\": '1'\n", "'rig':\n  \"exposure_us\": 5.5\n"),
    Case("empty value", "rig:\n  exposure_us:\n  a: 2\n", "rig:\n  exposure_us: 5.5\n  a: 2\n"),
]


@pytest.mark.parametrize("case", CASES, ids=[case.name for case in CASES])
def test_only_the_key_changes(case: Case) -> None:
    assert with_key(case.before, "rig.exposure_us", 5.5, "room.yaml") == case.after


@pytest.mark.parametrize(
    "text",
    [
        "a: &x {b: 1}\nrig: *x\n",
        "rig: &x {a: 2}\nb: *x\n",
        "rig: 5\n",
        "rig: {}\n",
        "{rig: {a: 1}}\n",
        "base: &b {exposure_us: 3}\nrig:\n  exposure_us: *c\n",
    ],
)
def test_an_unsafe_edit_is_refused_with_the_line_to_write(text: str) -> None:
    with pytest.raises(InputError):
        with_key(text, "rig.exposure_us", 5.5, "room.yaml")


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("b: 1\nrig: {c: {a: 2}}\n", "b: 1\nrig: {c: {a: 2, exposure_us: 5.5}}\n"),
        ("rig:\n  c:\n    a: 2\n  d: 3\n", "rig:\n  c:\n    exposure_us: 5.5\n    a: 2\n  d: 3\n"),
    ],
)
def test_a_key_of_a_section_within_a_section(before: str, after: str) -> None:
    assert with_key(before, "rig.c.exposure_us", 5.5, "room.yaml") == after


@pytest.mark.parametrize("text", ["b: 1\n", "rig: {c: 5}\n", "rig:\n  d: {}\n", "rig: {c: {}}\n"])
def test_a_section_within_a_section_is_not_made(text: str) -> None:
    with pytest.raises(InputError, match=r"write this one into 'rig\.c:' yourself: exposure_us: 5\.5"):
        with_key(text, "rig.c.exposure_us", 5.5, "room.yaml")


KEYS = st.text("abcde", min_size=1, max_size=4)
SCALARS = st.one_of(st.integers(), st.booleans(), st.text(max_size=8), st.none())
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(KEYS, inner, max_size=3)),
    max_leaves=6,
)


@settings(max_examples=60)
@given(st.dictionaries(KEYS, VALUES, min_size=1, max_size=4), st.booleans(), st.booleans())
def test_an_edit_changes_only_its_key_in_any_file(section: dict[str, object], flow: bool, there: bool) -> None:
    data: dict[str, Any] = {"one": 1, "rig": section | ({"exposure_us": 1} if there else {}), "two": [2, {"three": 3}]}
    parts = [yaml.safe_dump({key: value}, default_flow_style=False, allow_unicode=True) for key, value in data.items()]
    if flow:
        parts[1] = f"rig: {yaml.safe_dump(data['rig'], default_flow_style=True, allow_unicode=True)}"
    text = "# begin\n" + "# between\n".join(parts) + "# end\n"
    assume(yaml.safe_load(text) == data)  # PyYAML reads a lone next-line character, as it writes it, as a blank
    changed = with_key(text, "rig.exposure_us", 16666.7, "room.yaml")
    assert yaml.safe_load(changed) == data | {"rig": data["rig"] | {"exposure_us": 16666.7}}
    assert changed.startswith("# begin\n")
    assert changed.endswith("# end\n")
    assert changed.count("# between\n") == text.count("# between\n")


CONFIG = """\
# A rig of mine.
rig:
  backend: simulated   # or another
  seed: 0

projector: {width: 64, height: 48}   # small
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "room.yaml"
    path.write_text(CONFIG)
    return path


def test_the_file_is_edited_and_its_original_kept(path: Path) -> None:
    path.chmod(0o640)
    backup = set_keys(path, {"rig.exposure_us": 33333.3, "projector.response": [0.0, 0.4, 1.0]})
    assert backup.read_text() == CONFIG
    assert path.read_text() == CONFIG.replace("  backend", "  exposure_us: 33333.3\n  backend").replace(
        "height: 48}", "height: 48, response: [0.0, 0.4, 1.0]}"
    )
    config = load_config(path)
    assert config.rig.exposure_us == 33333.3
    assert config.projector.known_response.gamma > 1
    assert path.stat().st_mode & 0o777 == 0o640
    assert sorted(file.name for file in path.parent.iterdir()) == ["room.yaml", "room.yaml.bak"]
    assert set_keys(path, {"rig.exposure_us": 16666.7}) == backup
    assert backup.read_text() == CONFIG


def test_a_symbolic_link_is_kept(path: Path, tmp_path: Path) -> None:
    link = tmp_path / "link.yaml"
    link.symlink_to(path)
    set_keys(link, {"rig.exposure_us": 5.0})
    assert link.is_symlink()
    assert load_config(path).rig.exposure_us == 5.0


def test_byte_order_mark_and_carriage_returns_are_kept(path: Path) -> None:
    path.write_bytes(b"\xef\xbb\xbf" + CONFIG.replace("\n", "\r\n").encode())
    set_keys(path, {"rig.exposure_us": 5.0})
    data = path.read_bytes()
    assert data.startswith(b"\xef\xbb\xbf# A rig")
    assert data.count(b"\r\n") == data.count(b"\n") == CONFIG.count("\n") + 1


@pytest.mark.parametrize("value", [-1.0, "soon"])
def test_an_edit_that_makes_the_configuration_invalid_is_not_written(path: Path, value: object) -> None:
    with pytest.raises(InputError, match="exposure_us"):
        set_keys(path, {"rig.exposure_us": value})
    assert path.read_text() == CONFIG
    assert [file.name for file in path.parent.iterdir()] == ["room.yaml"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_is_reported(path: Path) -> None:
    path.parent.chmod(0o500)
    try:
        with pytest.raises(InputError, match="it is unchanged"):
            set_keys(path, {"rig.exposure_us": 5.0})
    finally:
        path.parent.chmod(0o700)
