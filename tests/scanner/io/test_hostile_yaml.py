"""Small YAML that would hang the program, fill its memory, or control a terminal."""

from itertools import pairwise
from pathlib import Path

import pytest

from scanner.capture import identity, open_capture
from scanner.configuration import load_config
from scanner.errors import InputError
from scanner.io import flow_yaml, parse_yaml
from tests.support.little_memory import little_memory
from tests.support.small_capture import read_listing


def aliases(levels: int = 9, width: int = 9) -> str:
    """Ten lines that stand for billions of values."""
    names = "abcdefghij"[:levels]
    lines = [f"{names[0]}: &{names[0]} [{', '.join('x' * width)}]"]
    lines += [f"{b}: &{b} [{', '.join([f'*{a}'] * width)}]" for a, b in pairwise(names)]
    return "\n".join(lines)


YAML: dict[str, tuple[str, str]] = {
    "aliases": (aliases(), "more than 30,000 values"),
    "merged aliases": (
        "b0: &b0 {k: 1}\n" + "\n".join(f"b{i}: &b{i} {{<<: [{', '.join([f'*b{i - 1}'] * 9)}]}}" for i in range(1, 9)),
        "more than 30,000 values",
    ),
    "a long text, often": (f"a: &a {'x' * 20_000}\nb: [{', '.join(['*a'] * 2000)}]", "more than 30,000 values"),
    "a value in itself": ("a: &a [*a]", "contains itself"),
    "brackets": ("[" * 100_000, "nested too deeply"),
    "many keys": ("\n".join(f"k{i}: 1" for i in range(40_000)), "more than 30,000 values"),
    "a type that is none": ("a: !!bool perhaps", "does not match its type tag"),
    "no number": ("a: !!int ''", "a number is expected"),
    "base sixty": ("a: !!int " + "1:" * 50_000 + "1", "a number is expected"),
    "a date that is none": ("a: 2024-13-45", "month must be in"),
    "a tag to be obeyed": ("!<%1b[31m> x", "could not determine a constructor"),
}  # fmt: skip


@pytest.mark.parametrize("name", YAML)
def test_hostile_yaml_is_refused(name: str) -> None:
    text, words = YAML[name]
    with little_memory(), pytest.raises(InputError, match=words) as caught:
        parse_yaml(text, "room.yaml")
    assert "\x1b" not in str(caught.value)
    assert len(str(caught.value)) < 400


def test_numbers_follow_yaml_1_2_with_64_bits() -> None:
    found = parse_yaml(f"[1:30, 1e3, 1_000, 0x1F, {'9' * 5000}, 0x{'f' * 5000}, {'1:' * 5000}1]", "")
    assert found == ["1:30", 1000.0, 1000, 31, "9" * 5000, f"0x{'f' * 5000}", f"{'1:' * 5000}1"]


def test_a_few_aliases_are_no_bomb() -> None:
    assert parse_yaml("a: &a {x: 1}\nb: *a\nc: {<<: *a, y: 2}", "")["c"] == {"x": 1, "y": 2}


def test_control_characters_are_escaped_and_long_values_cut(capture_folder: Path) -> None:
    listing = read_listing(capture_folder)
    listing |= {"devices": {"camera": "\x1b]0;title\x07" + "x" * 5000, "lens": [["a"] * 50] * 5}, "by\x9b31m": 1}
    (capture_folder / "capture.yaml").write_text(flow_yaml(listing))
    about = identity(open_capture(capture_folder).metadata)
    assert about["camera"].startswith("\N{REPLACEMENT CHARACTER}]0;title\N{REPLACEMENT CHARACTER}xxx")
    assert about["by\N{REPLACEMENT CHARACTER}31m"] == "1"
    assert max(map(len, about.values())) <= 200


def test_many_unknown_keys_give_a_short_message(tmp_path: Path) -> None:
    path = tmp_path / "room.yaml"
    path.write_text("\n".join(f"k{i}{'k' * 500}: 1" for i in range(1500)))
    with pytest.raises(InputError, match="and 1,488 more of the kind") as caught:
        load_config(path)
    assert len(str(caught.value).splitlines()) == 13
    assert max(map(len, str(caught.value).splitlines())) < 1500
