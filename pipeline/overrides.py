"""``--set key.path=value``: change any key of a case before it is validated."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from typing import Any

from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.messages import listed, shown, suggestion
from phantomnode.pipeline.schema import Case

_NAMED = ("material", "grid", "body", "interface", "contact", "boundary")


def apply_overrides(table: dict[str, Any], overrides: Sequence[str]) -> None:
    """Change a case, as read from TOML, in place.

    Parameters
    ----------
    table : dict
        The case.
    overrides : sequence of str
        Each ``key.path=value``; the value is TOML, or text where it is not; a number in the path is the place
        in a list, counted from 0.

    Raises
    ------
    CaseError
        With every override whose path leads nowhere.
    """
    faults = []
    for override in overrides:
        try:
            _apply(table, override)
        except CaseError as error:
            faults += [f"--set {override}: {message}" for message in error.messages]
    if faults:
        raise CaseError(faults)


def _apply(table: dict[str, Any], override: str) -> None:
    """Set one value."""
    path, equals, text = override.partition("=")
    if not equals or not all(key.strip() for key in path.split(".")):
        raise CaseError("write key.path=value, as in --set time.end=0.01")
    set_key(table, path, toml_value(text.strip()))


def set_key(table: dict[str, Any], path: str, value: Any) -> None:
    """Set one key of a case, as read from TOML, in place.

    Parameters
    ----------
    table : dict
        The case.
    path : str
        ``key.path``, as in :func:`apply_overrides`.
    value : object
        What TOML reads.

    Raises
    ------
    CaseError
        If the path leads nowhere.
    """
    keys = [key.strip() for key in path.split(".")]
    if not all(keys):
        raise CaseError("write the keys with single dots between them, as in time.end")
    if keys[0] not in Case.model_fields:
        known = listed(Case.model_fields)
        raise CaseError(
            f"unknown key {keys[0]!r}{suggestion(keys[0], Case.model_fields)}; a case knows {known}"
        )
    names = table.get(keys[0], {})
    if keys[0] in _NAMED and len(keys) > 2 and isinstance(names, dict) and keys[1] not in names:
        raise CaseError(
            f"there is no {keys[0]} {keys[1]!r}{suggestion(keys[1], names)}; this case has {listed(names)}"
        )
    holder: Any = table
    for depth, key in enumerate(keys[:-1]):
        holder = _inside(holder, key, ".".join(keys[: depth + 1]))
    _assign(holder, keys[-1], value, ".".join(keys[:-1]))


def _inside(holder: Any, key: str, path: str) -> Any:
    """The table or list at a key; a table that is not there yet is made (its keys are validated later)."""
    inner = holder[_index(holder, key, path)] if isinstance(holder, list) else holder.setdefault(key, {})
    if not isinstance(inner, dict | list):
        raise CaseError(f"{path} is {shown(inner)}, which has no keys; set {path} as a whole")
    return inner


def _assign(holder: Any, key: str, value: Any, path: str) -> None:
    """Put a value into a table or a list."""
    if isinstance(holder, list):
        holder[_index(holder, key, f"{path}.{key}")] = value
    else:
        holder[key] = value


def _index(holder: list[Any], key: str, path: str) -> int:
    """The place in a list that a key means."""
    if not re.fullmatch(r"[0-9]+", key) or int(key) >= len(holder):
        raise CaseError(f"{path}: the list {shown(holder)} has places 0 to {len(holder) - 1}, not {key!r}")
    return int(key)


def toml_value(text: str) -> Any:
    """A value as TOML reads it; plain text where it is not TOML, so that quotes may be left out."""
    try:
        parsed = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    return parsed["value"] if parsed.keys() == {"value"} else text
