"""Write docs/configuration.md from the schema that checks configurations:  python docs/make_configuration.py

The meaning of a key is its description in schema.py or sections.py of scanner/configuration, or in hw/settings.py; a
test fails while the file is stale.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from scanner.configuration import Config

TARGET = Path(__file__).parent / "configuration.md"

_UNITS = {
    "px": "pixels",
    "deg": "degrees",
    "us": "µs",
    "m": "m",
    "mm": "mm",
    "ms": "ms",
    "s": "s",
    "hz": "Hz",
    "electrons": "electrons",
    "nits": "cd/m²",
}
_UNITS_BY_KEY = {
    "width": "pixels",
    "height": "pixels",
    "known": "pixels",
    "px": "pixels",
    "px_per_frame": "pixels",
    "cell": "pixels",
    "periods": "pixels",
    "packet_size": "bytes",
    "bit_depth": "bits",
}
_TYPES = {"integer": "integer", "number": "number", "boolean": "boolean", "string": "string", "object": "keys by name"}

_INTRODUCTION = """\
# Configuration

<!-- Written by docs/make_configuration.py from the descriptions in the schema: change those, and run it again. -->

A configuration is a YAML file, such as [configs/room-sim.yaml](../configs/room-sim.yaml) or
[configs/room.yaml](../configs/room.yaml).

- A scan needs `rig.backend` and the sizes of camera and projector; `scan patterns` the projector's. All other keys are
  optional; `–` stands for a default that depends on the capture, as its meaning says.
- The command line overrides the file, with YAML values: `--set camera.width=640`.
- An unknown key or an impossible value is an error that names the nearest key or the possible values.
- Names contain units: `_px` pixels, `_deg` degrees, `_us` microseconds, `_m` metres, `_hz` hertz.
- `scan replay` and `scan calibrate` need only `camera.principal_point` and, for matches, the two sizes.
"""


def document() -> str:
    """All of docs/configuration.md."""
    schema = Config.model_json_schema()
    parts = [_INTRODUCTION, "## At the top\n", *_table(_values(schema, schema), "")]
    for name, field in schema["properties"].items():
        for section, key in _sections(schema, field, name):
            parts += _section(schema, section, key)
    return "\n".join(parts).rstrip() + "\n"


def _section(schema: dict[str, Any], section: dict[str, Any], key: str) -> list[str]:
    """A heading, what the section is, its keys, and the sections in it."""
    backend = section["properties"].get("backend", {}).get("const")
    title = f"`{key}:`" + (f" with `backend: {backend}`" if backend else "")
    parts = [f"## {title}\n", section["description"] + "\n", *_table(_values(schema, section), f"{key}.")]
    for name, field in section["properties"].items():
        for inner, inner_key in _sections(schema, field, f"{key}.{name}"):
            parts += _section(schema, inner, inner_key)
    return parts


def _sections(schema: dict[str, Any], field: dict[str, Any], key: str) -> Iterator[tuple[dict[str, Any], str]]:
    for option in _options(field):
        if "$ref" in option:
            yield schema["$defs"][option["$ref"].rpartition("/")[2]], key


def _options(field: dict[str, Any]) -> list[dict[str, Any]]:
    """What a field may be, without null; the kinds of a rig are options as well."""
    options = field.get("anyOf") or field.get("oneOf") or [field]
    found = [inner for option in options for inner in (option.get("oneOf") or option.get("anyOf") or [option])]
    return [option for option in found if option.get("type") != "null"]


def _values(schema: dict[str, Any], section: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {
        name: field
        for name, field in section["properties"].items()
        if not any(True for _ in _sections(schema, field, name))
    }


def _table(fields: dict[str, dict[str, Any]], prefix: str) -> list[str]:
    if not fields:
        return []
    rows = ["| key | type | default | meaning |", "| --- | --- | --- | --- |"]
    for name, field in fields.items():
        cells = (
            f"`{prefix}{name}`",
            ", ".join(filter(None, (_type(field), _unit(name)))),
            _default(field),
            _meaning(field),
        )
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return ["\n".join(rows) + "\n"]


def _type(field: dict[str, Any]) -> str:
    return " or ".join(dict.fromkeys(_one_type(option) for option in _options(field)))


def _one_type(option: dict[str, Any]) -> str:
    if "const" in option:
        return f"`{option['const']}`"
    if "enum" in option:
        return ", ".join(f"`{value}`" for value in option["enum"])
    if option.get("type") == "array":
        return _list_type(option)
    if option["type"] == "object":
        return _TYPES["object"]
    return _TYPES[option["type"]] + _range(option)


def _list_type(option: dict[str, Any]) -> str:
    inner = option.get("prefixItems") or [option["items"]]
    each = _one_type(inner[0])
    if "prefixItems" in option:
        return f"[x, y], each {each}"
    most = f"up to {option['maxItems']}, " if "maxItems" in option else ""
    return f"list of {most}each {each}"


def _range(option: dict[str, Any]) -> str:
    low, high = option.get("minimum"), option.get("maximum")
    above, below = option.get("exclusiveMinimum"), option.get("exclusiveMaximum")
    if low is not None and high is not None:
        return f", {low:.12g} to {high:.12g}"
    parts = [
        f"{words} {bound:.12g}"
        for words, bound in (("≥", low), (">", above), ("<", below), ("≤", high))
        if bound is not None
    ]
    return ", " + ", ".join(parts) if parts else ""


def _unit(name: str) -> str:
    return _UNITS_BY_KEY.get(name) or _UNITS.get(name.rpartition("_")[2] if "_" in name else "", "")


def _default(field: dict[str, Any]) -> str:
    value = field.get("default")
    if value is None or value == []:
        return "–"
    if isinstance(value, bool):
        return "`true`" if value else "`false`"
    return f"`{value:.6g}`" if isinstance(value, float) else f"`{value}`"


def _meaning(field: dict[str, Any]) -> str:
    if "description" not in field and "const" in field:
        return "Which kind of rig this is."
    return str(field["description"])


def main() -> None:
    """Write the file."""
    TARGET.write_text(document(), encoding="utf-8")
    print(TARGET)


if __name__ == "__main__":
    main()
