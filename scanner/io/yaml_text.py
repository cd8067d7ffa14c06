"""YAML, written for people and read from them: nothing executed or silently dropped, every error with its line."""

import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml

from scanner.errors import InputError
from scanner.io.given_file import read_bytes
from scanner.shown_text import harmless, shortened

_MOST_TEXT_BYTES = 1_000_000
_MOST_VALUES = 30_000
_LONG_TEXT = 1000  # characters that count as one value
_INT, _FLOAT = "tag:yaml.org,2002:int", "tag:yaml.org,2002:float"
_NUMBERS = {  # at most 64 bits, and no longer than anyone would write
    _INT: re.compile(r"[-+]?(0|[1-9][0-9_]{0,18}|0x[0-9a-fA-F_]{1,15}|0o?[0-7_]{1,20}|0b[01_]{1,60})$"),
    _FLOAT: re.compile(
        r"[-+]?(\d[\d_]{0,400}\.[\d_]{0,400}([eE][-+]?\d{1,9})?|\.\d[\d_]{0,400}([eE][-+]?\d{1,9})?"
        r"|\d{1,400}[eE][-+]?\d{1,9}|\.(inf|Inf|INF))$|\.(nan|NaN|NAN)$"
    ),
}


# Written by the C library where there is one, which is several times as fast.
_Dumper: type[yaml.SafeDumper] = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
_ANY_WIDTH = (1 << 31) - 1


class _Loader(yaml.SafeLoader):
    """Safe YAML in which a repeated key is an error and numbers are those of YAML 1.2: 1e3 is one, 1:30 is not.

    Values behind aliases are counted at each occurrence, because ten lines of them can be billions of values. Integers
    beyond 64 bits stay text, and control characters are replaced, because no reader uses them. Another `parser` of the
    same text may be its source.
    """

    yaml_implicit_resolvers = {  # noqa: RUF012
        first: [(tag, pattern) for tag, pattern in resolvers if tag not in _NUMBERS]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def __init__(self, text: str, parser: object = None) -> None:
        super().__init__(text)
        for name in ("check_event", "peek_event", "get_event") if parser else ():
            setattr(self, name, getattr(parser, name))
        self._values = 0
        self._values_in: dict[int, int] = {}

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        is_alias, before = self.check_event(yaml.AliasEvent), self._values
        place = self.peek_event().start_mark  # type: ignore[no-untyped-call]
        node = super().compose_node(parent, index)
        if is_alias:
            if id(node) not in self._values_in:
                raise yaml.composer.ComposerError(None, None, "a value that contains itself", place)
            self._values += self._values_in[id(node)]
        else:
            self._values += 1 + (len(node.value) // _LONG_TEXT if isinstance(node, yaml.ScalarNode) else 0)
            self._values_in[id(node)] = self._values - before
        if self._values > _MOST_VALUES:
            problem = f"more than {_MOST_VALUES:,} values, counting those that aliases stand for"
            raise yaml.composer.ComposerError(None, None, problem, place)
        return node

    def construct_scalar(self, node: Any) -> Any:
        value = super().construct_scalar(node)
        return harmless(value) if isinstance(value, str) else value

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            if key.value in keys:
                problem = f"the key '{shortened(key.value)}' is given twice"
                raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
            keys.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_number(self, node: yaml.ScalarNode) -> float:
        if _NUMBERS[_INT].match(node.value):
            whole = int(self.construct_yaml_int(node))
            return whole if node.tag == _INT else float(whole)
        if not _NUMBERS[node.tag].match(node.value):
            raise yaml.constructor.ConstructorError(None, None, "a number is expected here", node.start_mark)
        return float(self.construct_yaml_float(node))


for _tag, _pattern in _NUMBERS.items():
    _Loader.add_implicit_resolver(_tag, _pattern, list("-+.0123456789"))
    _Loader.add_constructor(_tag, _Loader.construct_number)


def parse_yaml(text: str, where: str) -> Any:
    """The value of a YAML text; `where` names its source in messages. Raises InputError."""
    try:
        return _loaded(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{where}, line {mark.line + 1}, column {mark.column + 1}" if mark else where
        raise InputError(f"{place}: not valid YAML: {_words(error.problem or error.context)}") from error
    except (LookupError, AttributeError, TypeError, ArithmeticError) as error:  # for example for '!!bool maybe'
        raise InputError(f"{where}: not valid YAML: a value does not match its type tag") from error
    except (yaml.YAMLError, ValueError) as error:
        raise InputError(f"{where}: not valid YAML: {_words(str(error))}") from error
    except RecursionError as error:
        raise InputError(f"{where}: not usable YAML: brackets are nested too deeply") from error


def _loaded(text: str) -> Any:
    """Parsed by the C library where there is one, and again by PyYAML for better words about what it refuses."""
    if yaml.__with_libyaml__:
        with suppress(yaml.scanner.ScannerError, yaml.parser.ParserError):
            return _Loader(text, yaml.CSafeLoader(text)).get_single_data()
    return yaml.load(text, _Loader)


def parse_mapping(text: str, where: str) -> dict[str, Any]:
    """The mapping that a YAML text is, empty for an empty text. Raises InputError if it is no mapping."""
    value = parse_yaml(text, where)
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise InputError(f"{where}: expected 'key: value' lines, found a {type(value).__name__}")
    return value


def _words(problem: str | None) -> str:
    """Return the parser's message, which may quote the file."""
    return shortened(harmless(" ".join(str(problem).split())), 200)


def read_yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file, empty for an empty file.

    Raises InputError if the file is missing, unreadable, not UTF-8, larger than a megabyte, or holds no mapping.
    """
    return parse_mapping(read_text(path), str(path))


def read_text(path: Path) -> str:
    """The text of a small UTF-8 file. Raises InputError."""
    try:
        return read_bytes(path, _MOST_TEXT_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file: byte {error.start} is not UTF-8") from error


def flow_yaml(value: object) -> str:
    """A value as YAML on one line; numbers are written so that they read back the same."""
    # In a list, because a lone number would be followed by an end-of-document mark.
    return _dumped([value], flow=True).strip()[1:-1]


def block_yaml(mapping: Mapping[str, Any]) -> str:
    """A mapping as YAML, lists of plain values on one line each and the rest in blocks; numbers are preserved."""
    return _dumped(dict(mapping), flow=None)


def _dumped(value: object, *, flow: bool | None) -> str:
    text = yaml.dump(
        value,
        Dumper=_Dumper,
        default_flow_style=flow,
        allow_unicode=flow is None,
        sort_keys=False,
        width=_ANY_WIDTH,
    )
    return str(text)
