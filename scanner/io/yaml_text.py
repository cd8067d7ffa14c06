"""Reading YAML that a person wrote: nothing is executed, nothing is silently dropped, every error names its line."""

import re
from pathlib import Path
from typing import Any

import yaml

from scanner.errors import InputError

_LARGEST_FILE_BYTES = 4_000_000


class _Loader(yaml.SafeLoader):
    """Safe YAML in which a repeated key is an error and 1e3 is a number, as in YAML 1.2."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            if key.value in seen:
                problem = f"the key '{key.value}' is given twice"
                raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def parse_yaml(text: str, where: str) -> Any:
    """The value of a YAML text; `where` names its source in messages. Raises InputError."""
    try:
        return yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{where}, line {mark.line + 1}, column {mark.column + 1}" if mark else where
        raise InputError(f"{place}: not valid YAML: {error.problem or error.context}") from error
    except (yaml.YAMLError, ValueError) as error:
        raise InputError(f"{where}: not valid YAML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise InputError(f"{where}: not usable YAML: brackets are nested too deeply") from error


def read_yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file, empty for an empty file.

    Raises InputError if the file is missing, unreadable, not UTF-8, larger than a few megabytes, or holds no mapping.
    """
    value = parse_yaml(read_text(path), str(path))
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise InputError(f"{path}: expected 'key: value' lines, found a {type(value).__name__}")
    return value


def read_text(path: Path) -> str:
    """The text of a small UTF-8 file. Raises InputError."""
    if not path.is_file():
        raise InputError(f"{path}: {'not a file' if path.exists() else 'no such file'}")
    try:
        size = path.stat().st_size
        if size > _LARGEST_FILE_BYTES:
            raise InputError(f"{path}: expected a small text file, found {size / 1e6:.0f} MB")
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file: byte {error.start} is not UTF-8") from error


def flow_yaml(value: object) -> str:
    """A value as YAML on one line; numbers are written so that they read back the same."""
    # In a list, because a lone number would be followed by a line with an end-of-document mark.
    return yaml.safe_dump([value], default_flow_style=True, sort_keys=False, width=float("inf")).strip()[1:-1]
