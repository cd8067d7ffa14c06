"""Editing single keys of a configuration file, with everything else unchanged, byte for byte; and
the commented examples to begin with.
"""

import os
import shutil
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

from scanner.configuration.schema import Config
from scanner.errors import InputError
from scanner.io import flow_yaml, parse_yaml, read_text, validate

BACKUP_SUFFIX = ".bak"
_MARK = "\ufeff"  # byte order mark of UTF-8


def set_keys(path: Path, values: Mapping[str, object]) -> Path:
    """Set keys such as 'rig.exposure_us' in a configuration file; return the path of the backup of the original file.

    The file is replaced as a whole or not at all. Raises InputError, with nothing changed, if the file cannot be read
    or written, or if the text cannot be edited without changing the meaning of other keys.
    """
    real = path.resolve()
    read_text(real)
    with real.open(encoding="utf-8", newline="") as file:
        text = file.read()
    mark = _MARK if text.startswith(_MARK) else ""
    changed = text.removeprefix(mark)
    for key, value in values.items():
        changed = with_key(changed, key, value, str(path))
    check_text(changed, path)
    return _replace(path, mark + changed)


def check_text(text: str, path: Path) -> None:
    """Raise InputError if a text is no configuration, naming `path`."""
    validate(Config, parse_yaml(text.removeprefix(_MARK), str(path)), str(path))


def write_text(path: Path, text: str) -> Path:
    """Replace a configuration file by a text, with its comments; returns the path of the original.

    Raises InputError, with nothing changed, if the text is no configuration, or cannot be written.
    """
    check_text(text, path)
    return _replace(path, text)


def _replace(path: Path, text: str) -> Path:
    real = path.resolve()
    backup = real.with_name(real.name + BACKUP_SUFFIX)
    fresh = real.with_name(f".{real.name}.{os.getpid()}.partial")
    try:
        if not backup.exists():
            shutil.copy2(real, backup)
        shutil.copy2(real, fresh)  # keeps the permissions
        with fresh.open("w", encoding="utf-8", newline="") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(real)
    except OSError as error:
        fresh.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be changed: {error.strerror}; it is unchanged") from error
    return backup


def with_key(text: str, key: str, value: object, where: str) -> str:
    """A YAML text in which 'section.name', or 'section.section.name', has that value, and nothing else is changed.

    Raises InputError.
    """
    *sections, name = key.split(".")
    before = parse_yaml(text, where)
    written = flow_yaml(value)
    changed = _changed(text, sections, name, written)
    wanted = _with(before, [*sections, name], value)
    if changed is None or _parsed(changed, where) != wanted:
        raise InputError(
            f"{where}: '{key}' cannot be set without changing other lines; write this one into '{'.'.join(sections)}:' "
            f"yourself: {name}: {written}"
        )
    return changed


def _with(data: Any, path: Sequence[str], value: object) -> Any:
    if not path:
        return value
    given = data if isinstance(data, dict) else {}
    return {**given, path[0]: _with(given.get(path[0]), path[1:], value)}


def _parsed(text: str, where: str) -> Any:
    try:
        return parse_yaml(text, where)
    except InputError:
        return None


def _changed(text: str, sections: Sequence[str], name: str, written: str) -> str | None:
    """Return the edited text; None if its form is not supported."""
    root = yaml.compose(text, yaml.SafeLoader)
    newline = "\r\n" if "\r\n" in text else "\n"
    if not isinstance(root, yaml.MappingNode) or root.flow_style:
        return None
    inner: yaml.Node | None = root
    for section in sections:
        inner = _value_of(inner, section) if isinstance(inner, yaml.MappingNode) else None
    if inner is None:
        separator = "" if text.endswith("\n") else newline
        return None if len(sections) > 1 else f"{text}{separator}{sections[0]}:{newline}  {name}: {written}{newline}"
    if not isinstance(inner, yaml.MappingNode) or not inner.value:
        return None
    old = _value_of(inner, name)
    if old is not None:
        begin, end = int(old.start_mark.index), _end_of(old, text)
        return text[:begin] + (" " if begin == end else "") + written + text[end:]
    if inner.flow_style:
        last = inner.value[-1][1]
        end = _end_of(last, text)
        return f"{text[:end]}, {name}: {written}{text[end:]}"
    # A new key is inserted before the block's first, with the same indentation.
    first = inner.value[0][0].start_mark
    return f"{text[: first.index]}{name}: {written}{newline}{' ' * first.column}{text[first.index :]}"


def _value_of(mapping: yaml.MappingNode, name: str) -> yaml.Node | None:
    return next((value for key, value in mapping.value if getattr(key, "value", None) == name), None)


def _end_of(node: yaml.Node, text: str) -> int:
    """Return where a value ends. YAML's end mark of a block lies past the blank lines and comments that follow it."""
    end = int(node.end_mark.index)
    if isinstance(node, yaml.CollectionNode) and not node.flow_style:
        return max((_end_of(_last_of(node), text), int(node.start_mark.index)))
    return end


def _last_of(node: yaml.CollectionNode) -> yaml.Node:
    last: yaml.Node | tuple[yaml.Node, yaml.Node] = node.value[-1]
    return last[1] if isinstance(last, tuple) else last


def example(name: str) -> str:
    """The text of one, by the name of its file."""
    return (files("scanner.configuration") / "examples" / name).read_text(encoding="utf-8")
