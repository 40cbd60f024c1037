"""The tables of a variant in those of its case: only the keys that differ are written, and take their places."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Path = tuple[str, ...]

NAMED = frozenset(
    {
        ("material",),
        ("grid",),
        ("body",),
        ("interface",),
        ("contact",),
        ("rigid",),
        ("boundary",),
        ("figure",),
        ("variant",),
        ("output", "profile"),
    }
)
"""Tables whose keys are names that the user gave: whatever they are, they say nothing of a kind."""

KINDS = (
    frozenset({"file", "rectangle", "circle", "ring", "polygon", "polyline", "function"}),
    frozenset({"displacement", "velocity", "acceleration", "traction", "pressure"}),
    frozenset({"times_auto", "times_E", "value"}),
    frozenset({"cell", "counts"}),
)
"""Keys of which a table has one: that of a variant takes the place of the one that the case has."""

BESIDE = {
    "file": frozenset({
        "unit", "region", "layers", "without_layers", "trust_scripts", "time_limit", "face", "section",
    }),
    "function": frozenset({"x"}),
    "pressure": frozenset({"follower"}),
}  # fmt: skip
"""Keys that say something of another one only, and go with it."""


def merged(table: Mapping[str, Any], changes: Mapping[str, Any], path: Path = ()) -> dict[str, Any]:
    """A table with some keys changed; tables within it key by key. ``path`` leads to it from the case.

    Where a key says of which kind something is, that of the table goes: a polygon takes the place of a circle, and a
    table of another ``kind`` that of the whole one.
    """
    kept = dict(table)
    if path not in NAMED:
        if "kind" in changes and changes["kind"] != table.get("kind"):
            return dict(changes)
        kept = {key: value for key, value in table.items() if key not in _replaced(table, changes)}
    both = {
        key: merged(kept[key], value, (*path, key))
        for key, value in changes.items()
        if isinstance(value, Mapping) and isinstance(kept.get(key), Mapping)
    }
    return {**kept, **changes, **both}


def _replaced(table: Mapping[str, Any], changes: Mapping[str, Any]) -> set[str]:
    """Keys of a table that are of another kind than those in their place, and what goes with them."""
    gone = set[str]()
    for kind in KINDS:
        if kind & changes.keys():
            gone |= (kind & table.keys()) - changes.keys()
    return gone.union(*(BESIDE.get(key, frozenset()) for key in gone))
