import importlib.util
from pathlib import Path
from typing import Any

import pytest
import yaml

from scanner.configuration import Config, load_config
from scanner.errors import InputError
from scanner.io import known_keys
from tests.support.places import ROOT


def module(path: Path) -> Any:
    specification = importlib.util.spec_from_file_location(path.stem, path)
    assert specification is not None
    assert specification.loader is not None
    loaded = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(loaded)
    return loaded


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
