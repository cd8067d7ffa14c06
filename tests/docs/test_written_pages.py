"""Pages and diagrams are what their scripts write from the code: keys described, findings declared once."""

import importlib.util
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

from scanner.configuration import Config, load_config
from scanner.errors import InputError
from scanner.io import known_keys
from tests.support.places import ROOT

SVG = "{http://www.w3.org/2000/svg}"
MOST_BYTES = 40_000
# Numbers without a unit end in what they count or compare.
ENDINGS = [
    "_share",
    "_ratio",
    "_percent",
    "_px",
    "_mm",
    "_ms",
    "_s",
    "_deg",
    "_grey_levels",
    "_widths",
    "_sigma",
    "_thousandths",
    "_less_likely",
    "_captures",
    "_frames",
    "_matches",
]
COUNTS = {
    *("frames", "captures", "bits", "faces", "matches", "points", "pixels", "planes", "views", "changes"),
    *("cost", "limit", "exponent"),
}


def module(path: Path) -> Any:
    specification = importlib.util.spec_from_file_location(path.stem, path)
    assert specification is not None
    assert specification.loader is not None
    loaded = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(loaded)
    return loaded


MAKER = module(ROOT / "docs" / "make_findings.py")


def test_the_reference_matches_the_schema() -> None:
    written = (ROOT / "docs" / "configuration.md").read_text(encoding="utf-8")
    assert written == module(ROOT / "docs" / "make_configuration.py").document(), (
        "docs/configuration.md is stale: run python docs/make_configuration.py"
    )


def test_the_reference_has_every_key() -> None:
    written = (ROOT / "docs" / "configuration.md").read_text(encoding="utf-8")
    keys = set(known_keys(Config))
    sections = {key for key in keys if any(other.startswith(f"{key}.") for other in keys)}
    assert [key for key in sorted(keys - sections) if f"|`{key}` |" not in written] == []
    assert [key for key in sorted(sections) if f"`{key}:`" not in written] == []


def misspelt(name: str) -> list[str]:
    """Misspell a word: one letter missing, one doubled, or two exchanged."""
    middle = len(name) // 2
    return [
        name[:middle] + name[middle + 1 :],
        name[:middle] + name[middle] + name[middle:],
        name[: middle - 1] + name[middle] + name[middle - 1] + name[middle + 1 :],
    ]


@pytest.mark.parametrize("backend", ["simulated", "aravis"])
def test_a_misspelt_key_at_any_depth_names_the_right_one(tmp_path: Path, backend: str) -> None:
    keys = list(dict.fromkeys(known_keys(Config, kinds=[backend])))
    path, wrong = tmp_path / "room.yaml", []
    for key in keys:
        if backend == "aravis" and not key.startswith("rig"):
            continue  # the same as with the other
        *sections, name = key.split(".")
        for spelling in misspelt(name):
            if ".".join([*sections, spelling]) in keys:
                continue
            data: Any = {spelling: 1}
            for section in reversed(sections):
                data = {section: [data] if section == "steps" else data}
            if sections[:1] == ["rig"]:
                data["rig"]["backend"] = backend
            path.write_text(yaml.safe_dump(data))
            with pytest.raises(InputError) as caught:
                load_config(path)
            if f"did you mean '{key}'?" not in str(caught.value):
                wrong.append((key, spelling, str(caught.value)))
    assert wrong == []


def test_a_key_of_the_other_kind_of_rig_is_named_as_such() -> None:
    with pytest.raises(InputError, match="another kind of this section"):
        load_config(None, ["rig={backend: simulated, gain: 3}"])


def test_only_keys_of_the_chosen_rig_are_suggested() -> None:
    with pytest.raises(InputError) as caught:
        load_config(None, ["rig={backend: simulated, trigge: line}"])
    assert "trigger" not in str(caught.value)


@pytest.fixture(scope="module")
def diagrams() -> dict[str, Callable[[], object]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "docs")
        return dict(module(ROOT / "docs" / "make_diagrams.py").DIAGRAMS)


def test_stored_diagrams_are_current(diagrams: dict[str, Callable[[], object]]) -> None:
    assert len(diagrams) >= 10
    for name, draw in diagrams.items():
        written = (ROOT / "docs" / "images" / f"{name}.svg").read_text(encoding="utf-8")
        assert written == str(draw()), f"{name}.svg is stale: run python docs/make_diagrams.py"
        assert len(written.encode()) < MOST_BYTES
        drawing = ElementTree.fromstring(written)
        assert all(len(drawing.findtext(f"{SVG}{tag}") or "") > 10 for tag in ("title", "desc"))


def test_the_page_matches_the_code() -> None:
    assert (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8") == MAKER.document(), (
        "docs/troubleshooting.md is stale: run python docs/make_findings.py"
    )


def test_each_kind_is_declared_once() -> None:
    counts = Counter(kind.name for kind in MAKER.declared_kinds())
    assert len(counts) > 100
    assert {name: count for name, count in counts.items() if count > 1} == {}


def test_kinds_say_what_they_mean_and_in_which_unit() -> None:
    kinds = MAKER.declared_kinds()
    assert [kind.name for kind in kinds if not re.fullmatch(r"[a-z]+(-[a-z]+)*", kind.name)] == []
    assert [kind.name for kind in kinds if not kind.meaning.endswith(".")] == []
    assert [kind.name for kind in kinds if kind.remedy and not kind.remedy.endswith(".")] == []
    numbers = {name for kind in kinds for name in kind.data}
    assert sorted(name for name in numbers if name not in COUNTS and not name.endswith(tuple(ENDINGS))) == []
