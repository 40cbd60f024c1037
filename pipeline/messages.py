"""Validation errors in the words of a case file: key, value, what is wrong, what to do."""

from __future__ import annotations

import types
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, Tag, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from phantomnode.pipeline.schema import Case
from phantomnode.pipeline.values import NAME_PATTERN, PLACE_OR_NAME_PATTERN, PLACE_PATTERN

Keys = tuple[int | str, ...]

_LIMITS = {
    "greater_than": ("gt", "must be greater than"),
    "greater_than_equal": ("ge", "must be at least"),
    "less_than": ("lt", "must be less than"),
    "less_than_equal": ("le", "must be at most"),
}
_KINDS = {
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "bool_type": "must be true or false",
    "string_type": 'must be text in quotes, "..."',
    "tuple_type": "must be a list, [...]",
    "dict_type": "must be a table, { key = value }",
    "model_type": "must be a table, { key = value }",
    "model_attributes_type": "must be a table, { key = value }",
    "finite_number": "must be a finite number",
    "string_too_short": "must not be empty",
    "path_type": 'must be text in quotes, "..."',
}


def describe(errors: ValidationError, table: Mapping[str, Any], root: type[BaseModel] = Case) -> list[str]:
    """One message for each thing that is wrong in a case, or in another file of tables.

    Parameters
    ----------
    errors : ValidationError
        What pydantic found.
    table : mapping
        The case as it was read, before validation.
    root : model
        What the file holds.

    Returns
    -------
    list of str
        Each starts with the key path, such as ``body.ring.initial_velocity``.
    """
    found = errors.errors(include_url=False)
    # A list is also called too short when entries of it are faulty; their own messages say it better.
    kept = [e for e in found if e["type"] != "too_short" or not any(_inside(other, e) for other in found)]
    return [_describe(error, table, root) for error in kept]


def suggestion(name: str, known: Iterable[str]) -> str:
    """A hint at the closest known name: " (did you mean 'x'?)", or nothing."""
    choices = list(known)
    lowered = {choice.lower(): choice for choice in choices}
    close = get_close_matches(name.lower(), lowered, 1, 0.5)
    return f" (did you mean {lowered[close[0]]!r}?)" if close else ""


def listed(names: Iterable[str]) -> str:
    """Names for a message: "a, b, c", or "none"."""
    return ", ".join(names) or "none"


def shown(value: Any) -> str:
    """A value as it stands in a case file, short enough for a message."""
    if isinstance(value, bool):
        return str(value).lower()
    text = f'"{value}"' if isinstance(value, str) else _toml_inline(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _toml_inline(value: Any) -> str:
    """A list or table on one line."""
    if isinstance(value, Mapping):
        return (
            "{}"
            if not value
            else "{ " + ", ".join(f"{key} = {shown(item)}" for key, item in value.items()) + " }"
        )
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(shown(item) for item in value) + "]"
    return str(value)


def _inside(inner: ErrorDetails, outer: ErrorDetails) -> bool:
    """Whether an error lies deeper at the same location as another."""
    depth = len(outer["loc"])
    return len(inner["loc"]) > depth and inner["loc"][:depth] == outer["loc"]


def _describe(error: ErrorDetails, table: Mapping[str, Any], root: type[BaseModel]) -> str:
    """One error as a message."""
    loc, kind, context = error["loc"], error["type"], error.get("ctx", {})
    path = dotted(loc)
    if kind == "extra_forbidden":
        return _unknown_key(loc, root)
    if kind == "missing":
        return _missing(loc, table, root)
    if kind == "value_error":
        return f"{path}: {context['error']}" if path else str(context["error"])
    if loc and loc[-1] == "[key]":
        name = error["input"]
        return f"{dotted(loc[:-2])}: {name!r} cannot be a name; use letters, digits, _ and -, a letter first"
    return f"{path} = {shown(error['input'])}: {_fault(error)}{_meaning(loc, root)}"


def _fault(error: ErrorDetails) -> str:
    """What is wrong with a value."""
    kind, context, value = error["type"], error.get("ctx", {}), error["input"]
    if kind in _LIMITS:
        key, words = _LIMITS[kind]
        return f"{words} {context[key]:g}"
    if kind == "literal_error":
        choices = str(context["expected"]).replace("'", '"')
        return f"must be {choices}" + _closest_choice(value, choices.replace(" or ", ", ").split(", "))
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        return _wrong_kind(error)
    if kind == "string_pattern_mismatch":
        return _PATTERNS[context["pattern"]]
    if kind in ("too_long", "too_short"):
        few = "at least" if kind == "too_short" else "at most"
        count = context.get("min_length" if kind == "too_short" else "max_length")
        return f"needs {few} {count} {'entry' if count == 1 else 'entries'}, not {context['actual_length']}"
    return _KINDS.get(kind, error["msg"])


_PATTERNS = {
    NAME_PATTERN: "must be a name of letters, digits, _ and -, a letter first",
    PLACE_OR_NAME_PATTERN: 'must be "NAME.PART", as in "block.top", or the name of a rigid obstacle',
    PLACE_PATTERN: 'must be "NAME.PART", the name of a body or interface and its part, as in "ring.outer"',
}
_TAGS = {"=number": "a number", "=text": "text in quotes", "=table": "a table", "=list": "a list"}


def _wrong_kind(error: ErrorDetails) -> str:
    """The message for a value whose kind fits none of the alternatives."""
    expected = [tag.strip("'") for tag in str(error.get("ctx", {}).get("expected_tags", "")).split(", ")]
    if "=cartesian" not in expected:
        return "must be " + " or ".join(_TAGS[tag] for tag in expected if tag in _TAGS)
    value = error["input"]
    kinds = ("cartesian", "polar", "mapped")
    words = 'needs kind = "cartesian", "polar" or "mapped", or file = "..."'
    kind = value.get("kind") if isinstance(value, Mapping) else None
    return words + (suggestion(kind, kinds) if isinstance(kind, str) else "")


def _closest_choice(value: Any, choices: Sequence[str]) -> str:
    """The closest of several quoted choices."""
    return suggestion(value, [choice.strip('"') for choice in choices]) if isinstance(value, str) else ""


def _unknown_key(loc: Keys, root: type[BaseModel]) -> str:
    """The message for a key that does not exist, with those that do."""
    owner = model_at(loc[:-1], root)
    valid = list(owner.model_fields) if owner else []
    where = dotted(loc[:-1]) or f"the {root.__name__.lower()}"
    return f"{dotted(loc)}: unknown key{suggestion(str(loc[-1]), valid)}; {where} knows {listed(valid)}"


def _missing(loc: Keys, table: Mapping[str, Any], root: type[BaseModel]) -> str:
    """The message for a key, or an entry of a list, that is not there."""
    if isinstance(loc[-1], int):
        given = value_at(table, loc[:-1])
        return (
            f"{dotted(loc[:-1])} = {shown(given)}: needs {_entries(loc[:-1], root)}{_meaning(loc[:-1], root)}"
        )
    return f"{dotted(loc)}: is missing; add it{_meaning(loc, root)}"


def _entries(loc: Keys, root: type[BaseModel]) -> str:
    """How many entries a fixed list has, in words."""
    annotation, _ = _walk(loc, root)
    count = len([entry for entry in get_args(_plain(annotation)) if entry is not Ellipsis])
    return f"{count} entries" if count else "more entries"


def _meaning(loc: Keys, root: type[BaseModel]) -> str:
    """What the key means and its unit, from the schema."""
    for end in range(len(loc), 0, -1):
        _, field = _walk(loc[:end], root)
        if field is not None and field.description:
            return f" ({field.description})"
    return ""


def dotted(loc: Sequence[int | str]) -> str:
    """A location as a key path, without the tags of alternatives."""
    return ".".join(str(key) for key in loc if not (isinstance(key, str) and key.startswith("=")))


def value_at(table: Any, loc: Sequence[int | str]) -> Any:
    """The value at a location of the case as it was read; None where there is none."""
    for key in loc:
        if isinstance(key, str) and key.startswith("="):
            continue
        try:
            table = table[key]
        except (KeyError, IndexError, TypeError):
            return None
    return table


def model_at(loc: Keys, root: type[BaseModel] = Case) -> type[BaseModel] | None:
    """The model of the table at a location, None where there is no table."""
    annotation = _plain(_walk(loc, root)[0])
    return annotation if isinstance(annotation, type) and issubclass(annotation, BaseModel) else None


def _walk(loc: Keys, root: type[BaseModel]) -> tuple[Any, FieldInfo | None]:
    """The type at a location, and the field where the location ends on one."""
    annotation: Any = root
    field: FieldInfo | None = None
    for key in loc:
        annotation = _plain(annotation)
        if isinstance(key, str) and key.startswith("="):
            annotation = next(
                (member for member in get_args(annotation) if Tag(key) in _metadata(member)), None
            )
        elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
            field = annotation.model_fields.get(str(key))
            annotation = field.annotation if field else None
        else:
            field, annotation = None, _entry(annotation, key)
    return annotation, field


def _entry(annotation: Any, key: int | str) -> Any:
    """The type of one entry of a dict or tuple type."""
    arguments = get_args(annotation)
    if get_origin(annotation) is dict:
        return arguments[1]
    if get_origin(annotation) is tuple and isinstance(key, int):
        return arguments[0] if arguments[-1] is Ellipsis else arguments[min(key, len(arguments) - 1)]
    return None


def _plain(annotation: Any) -> Any:
    """A type without Annotated and without "or None"."""
    while True:
        if get_origin(annotation) is Annotated:
            annotation = get_args(annotation)[0]
            continue
        if get_origin(annotation) in (Union, types.UnionType):
            members = [member for member in get_args(annotation) if member is not type(None)]
            if len(members) == 1:
                annotation = members[0]
                continue
        return annotation


def _metadata(annotation: Any) -> tuple[Any, ...]:
    """The metadata of an Annotated type."""
    return getattr(annotation, "__metadata__", ())
