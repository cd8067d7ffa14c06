"""Validate parsed files into typed values that belong to the expected devices.

The only place that turns pydantic's findings into sentences.
"""

from collections.abc import Iterable, Iterator, Sequence
from difflib import SequenceMatcher
from typing import Annotated, Any, TypeVar, cast, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from calib.geometry import Size
from scanner.errors import InputError
from scanner.shown_text import harmless, shortened, shown

# Strict, because otherwise `true` would be accepted as 1 and '5' as 5.
Whole = Annotated[int, Field(strict=True)]
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Flag = Annotated[bool, Field(strict=True)]
Pair = tuple[Number, Number]
SHORTEST_M, LONGEST_M = 1e-6, 1e4
Metres = Annotated[Number, Field(ge=SHORTEST_M, le=LONGEST_M)]  # a length of devices and what they see

Model = TypeVar("Model", bound=BaseModel)
_SIMILAR = 0.6
_MOST_LINES = 12  # fit a screen
_LONGEST_KEY = 80


class Entry(BaseModel):
    """A part of a data file: immutable; keys that it does not know are left to other readers."""

    model_config = ConfigDict(frozen=True, extra="ignore")


def validate(model: type[Model], data: object, where: str) -> Model:
    """Check `data` (as read from YAML) against a model. Raises InputError with a line for every key that is wrong."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        lines = [_explain(details, data, model) for details in problems[:_MOST_LINES]]
        if len(problems) > _MOST_LINES:
            lines.append(f"and {len(problems) - _MOST_LINES:,} more of the kind")
        raise InputError("\n".join(f"{where}: {line}" for line in dict.fromkeys(lines))) from error


def _explain(details: ErrorDetails, data: object, model: type[BaseModel]) -> str:
    location = _keys_in_file(details["loc"], data, missing=details["type"] == "missing")
    key, value, context = _dotted(location), details["input"], details.get("ctx", {})
    match details["type"]:
        case "extra_forbidden":
            return f"unknown key '{key}'; {_suggestion(key, model, details['loc'])}"
        case "missing":
            return f"'{key}' is missing"
        case "union_tag_not_found":
            return f"'{key}.{_tag_key(context)}' is missing"
        case "union_tag_invalid":
            return (
                f"'{key}.{_tag_key(context)}' must be one of {context['expected_tags']}, found {shown(context['tag'])}"
            )
        case "model_type" | "model_attributes_type" | "dict_type":
            return f"'{key}' must be a section of 'key: value' lines, found {shown(value)}"
        case "value_error" | "assertion_error":
            message = str(context["error"])
            return f"'{key}': {message}" if key else message
        case _:
            return f"'{key}' {_requirement(details['msg'])}, found {shown(value)}"


def _tag_key(context: dict[str, Any]) -> str:
    return str(context["discriminator"]).strip("'")


def _requirement(message: str) -> str:
    """Pydantic's 'Input should be greater than 0' → 'must be greater than 0'."""
    for start in ("Input should", "Value should", "Tuple should", "List should", "String should"):
        if message.startswith(start):
            return "must" + message.removeprefix(start).replace("a valid tuple", "a list, as in [a, b]")
    return f"is wrong ({message})"


def _dotted(location: Sequence[int | str]) -> str:
    text = ""
    for item in location:
        text += f"[{item}]" if isinstance(item, int) else f".{item}"
    return shortened(harmless(text.removeprefix(".")), _LONGEST_KEY)


def _keys_in_file(location: Sequence[int | str], data: object, *, missing: bool) -> list[int | str]:
    """Pydantic puts the chosen member of a union into the location; a reader knows only the keys of the file."""
    kept: list[int | str] = []
    for item in location:
        in_list = isinstance(data, list) and isinstance(item, int) and item < len(data)
        if in_list or (isinstance(data, dict) and item in data):
            data = cast(dict[int | str, object], data)[item]
            kept.append(item)
    return [*kept, location[-1]] if missing else kept


def _suggestion(key: str, model: type[BaseModel], location: Sequence[int | str]) -> str:
    """The known key most like `key`, by its full path or by its last part; otherwise the known keys at that place.

    `location` contains the chosen member of a section with several kinds.
    """
    if key in known_keys(model):
        return "it belongs to another kind of this section"
    known = list(dict.fromkeys(known_keys(model, kinds=location)))
    whole = {candidate: _alike(key, candidate) for candidate in known}
    likeness = {candidate: max(alike, _alike(_leaf(key), _leaf(candidate))) for candidate, alike in whole.items()}
    best = max(known, key=lambda candidate: (likeness[candidate], whole[candidate]))
    if likeness[best] >= _SIMILAR:
        return f"did you mean '{best}'?"
    parent = key.rpartition(".")[0]
    siblings = [candidate for candidate in known if candidate.rpartition(".")[0] == parent]
    return f"known here: {', '.join(siblings or known)}"


def _alike(a: str, b: str) -> float:
    return SequenceMatcher(None, a, b).ratio()


def _leaf(key: str) -> str:
    return key.rpartition(".")[2]


def known_keys(model: type[BaseModel], prefix: str = "", kinds: Sequence[int | str] = ()) -> Iterator[str]:
    """Every key of a model and of its sections, as dotted paths; of sections that come in kinds, those of `kinds`."""
    for attribute, field in model.model_fields.items():
        name = field.alias or attribute
        yield prefix + name
        sections = list(_models_in(field.annotation))
        for section in [section_type for section_type in sections if _is_one_of(section_type, kinds)] or sections:
            yield from known_keys(section, f"{prefix}{name}.", kinds)


def _is_one_of(model: type[BaseModel], kinds: Sequence[int | str]) -> bool:
    """Whether one of the model's keys has a single possible value, which is among the kinds."""
    constants = [get_args(field.annotation) for field in model.model_fields.values()]
    return any(len(values) == 1 and values[0] in kinds for values in constants)


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)


def refuse_other_sizes(
    what: object, actual: Iterable[Size], expected: Iterable[Size], whose: str, why: str = ""
) -> None:
    """Raise InputError if the sizes of camera and projector differ; `expected` are `whose`, `why` ends the message."""
    for name, size, wanted in zip(("camera", "projector"), actual, expected, strict=True):
        if size != wanted:
            raise InputError(f"{what}: its {name} is {size}, but {whose} is {wanted}{why}")
