"""Write docs/configuration.md from the schema that checks configurations:  python docs/make_configuration.py

The meaning of a key is its description in schema.py or sections.py of scanner/configuration, in hw/settings.py, or in a
camera's own file; a test fails while the page is stale.
"""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hw.settings import SimulatedRigSettings
from scanner.configuration import Config

TARGET = Path(__file__).parent / "configuration.md"

_INTRODUCTION = """\
# Configuration

<!-- Written by docs/make_configuration.py from the descriptions in the schema: change those, and run it again. -->

A configuration is a YAML file, such as [configs/room-sim.yaml](../configs/room-sim.yaml) or
[configs/room.yaml](../configs/room.yaml); `scan new` writes one.

- A scan needs `rig.backend` and the sizes of camera and projector; `scan patterns` the projector's; `scan replay` only
  `camera.principal_point`; `scan calibrate` also the sizes. Everything else is optional.
- The command line overrides the file, with YAML values: `--set camera.width=640`.
- An unknown key or impossible value is an error that names the nearest key or the possible values.
- Values are numbers where the table says nothing else. Names end in their units: pixels, degrees, metres, µs, Hz.
"""
_HEADER = "|key |values (default) |meaning|\n|--- |--- |---|"
_REAL_DEVICES = """\
## `rig:`

`rig.backend` names the kind of rig; each has keys of its own. These belong to every rig of real devices:
"""

Schema = dict[str, Any]


def document() -> str:
    """All of docs/configuration.md."""
    schema = Config.model_json_schema()
    rigs, sections, top = [], [], []
    for name, field in schema["properties"].items():
        options = list(_sections(schema, field))
        if name == "rig":
            rigs = options
        elif options:
            sections += [_section(schema, option, name) for option in options]
        else:
            top.append(_row(field, name))
    real = [rig for rig in rigs if rig["title"] != SimulatedRigSettings.__name__]
    rows = Counter(row for rig in real for row in _rows(schema, rig, "rig"))
    shared = [row for row, count in rows.items() if count == len(real)]
    names = ", ".join(f"`{rig['properties']['backend']['const']}`" for rig in (*real, *rigs[:1]))
    backend = _line("`rig.backend`", f"{names} (`simulated`)", "The kind of rig.")
    return "\n".join(
        [
            _INTRODUCTION,
            _table("## At the top\n", top),
            _table(_REAL_DEVICES, [backend, *shared]),
            *(_section(schema, rig, "rig", shared) for rig in real),
            *sections,
            *(_section(schema, rig, "rig") for rig in rigs if rig not in real),
        ]
    )


def _section(schema: Schema, section: Schema, key: str, elsewhere: list[str] | None = None) -> str:
    """A heading, what the section is, and its keys but for the rows that stand elsewhere."""
    backend = section["properties"].get("backend", {}).get("const")
    title = f"## `{key}:`" + (f" with `backend: {backend}`" if backend else "")
    rows = [row for row in _rows(schema, section, key) if row not in (elsewhere or ())]
    return _table(f"{title}\n\n{section['description']}\n", rows)


def _table(title: str, rows: list[str]) -> str:
    return "\n".join([title, _HEADER, *rows, ""])


def _rows(schema: Schema, section: Schema, key: str) -> Iterator[str]:
    """A row for each key, those of the sections within it last."""
    inner = []
    for name, field in section["properties"].items():
        options = list(_sections(schema, field))
        inner += [(f"{key}.{name}", option) for option in options]
        if field.get("type") == "array" and options:
            yield _line(f"`{key}.{name}`", f"list of up to {field['maxItems']}", field["description"])
        elif not options and "const" not in field and _options(field):
            yield _row(field, f"{key}.{name}")
    for name, option in inner:
        yield _line(f"`{name}:`", "", f"**{option['description']}**")
        yield from _rows(schema, option, name)


def _row(field: Schema, key: str) -> str:
    values = " or ".join(dict.fromkeys(map(_values, _options(field))))
    return _line(f"`{key}`", values + _default(field), field["description"])


def _line(*cells: str) -> str:
    return "|" + " |".join(cell.replace("|", "\\|") for cell in cells) + "|"


def _sections(schema: Schema, field: Schema) -> Iterator[Schema]:
    """The sections that a field may be: more than one of a rig."""
    for option in _options(field):
        reference = option.get("$ref") or option.get("items", {}).get("$ref")
        if reference:
            yield schema["$defs"][reference.rpartition("/")[2]]


def _options(field: Schema) -> list[Schema]:
    """What a field may be, without null; the kinds of a rig are options as well."""
    options = field.get("anyOf") or field.get("oneOf") or [field]
    found = [inner for option in options for inner in (option.get("oneOf") or option.get("anyOf") or [option])]
    return [option for option in found if option.get("type") != "null"]


def _values(option: Schema) -> str:
    if "const" in option:
        return f"`{option['const']}`"
    if "enum" in option:
        return ", ".join(f"`{value}`" for value in option["enum"])
    if option["type"] == "array":
        return _list(option)
    names = {"string": "text", "boolean": "boolean", "object": "keys by name"}
    whole = "integer " if option["type"] == "integer" else ""
    return names.get(option["type"]) or (whole + _range(option)).strip() or "number"


def _list(option: Schema) -> str:
    if "prefixItems" in option:
        return "[x, y]"
    return f"list of up to {option['maxItems']}: {_values(option['items'])}"


def _range(option: Schema) -> str:
    low, high = option.get("minimum"), option.get("maximum")
    if low is not None and high is not None:
        return f"{low:.12g}…{high:.12g}"
    signs = (("≥", low), (">", option.get("exclusiveMinimum")), ("≤", high), ("<", option.get("exclusiveMaximum")))
    return ", ".join(f"{sign}{bound:.12g}" for sign, bound in signs if bound is not None)


def _default(field: Schema) -> str:
    value = field.get("default")
    if value is None or value == []:
        return ""
    if isinstance(value, bool):
        return f" (`{str(value).lower()}`)"
    return f" (`{value:.6g}`)" if isinstance(value, float) else f" (`{value}`)"


def main() -> None:
    """Write the file."""
    TARGET.write_text(document(), encoding="utf-8")
    print(TARGET)


if __name__ == "__main__":
    main()
