"""The reference of the case file, as Markdown made of its schema: case_file.md, which a test holds to it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from phantomnode.pipeline.case import json_schema
from phantomnode.pipeline.values import NAME_PATTERN, PLACE_OR_NAME_PATTERN, PLACE_PATTERN

Schema = Mapping[str, Any]

TEXTS = {
    NAME_PATTERN: "name",
    PLACE_PATTERN: '"BODY.PART"',
    PLACE_OR_NAME_PATTERN: '"BODY.PART" or a name',
}
"""What texts of these patterns are."""

HEAD = """\
# The case file, key by key

Made from the schema by `phantomnode schema --markdown`; the [README](../README.md#the-case-file) explains what the
keys do together. TOML, in SI units (m, s, kg, Pa; forces per metre of thickness; angles in degrees). **Bold** keys
must be given. Unknown keys are errors that name the valid ones.

Editors that know TOML (Even Better TOML in VS Code, taplo) complete keys and mark what is wrong where the first line
of the file is `#:schema ./case.schema.json` and that file lies beside it: `phantomnode new` writes both, and
`phantomnode schema > case.schema.json` writes it anew.
"""


def reference() -> str:
    """The whole page."""
    schema = json_schema()
    parts = [HEAD, "## The top of the file\n", *_table(schema)]
    for name in _in_order(schema):
        entry = schema["$defs"][name]
        parts += [f"## {name}\n", f"{entry.get('description', '').strip()}\n", *_table(entry)]
    return "\n".join(parts)


def _in_order(schema: Schema) -> list[str]:
    """The names of all tables, each after the one that names it first."""
    found: list[str] = []

    def look(value: Any) -> None:
        if isinstance(value, Mapping):
            name = str(value.get("$ref", "")).rpartition("/")[2]
            if name and name not in found:
                found.append(name)
                look(schema["$defs"][name])
            for key, inner in value.items():
                if key != "$defs":
                    look(inner)
        elif isinstance(value, list):
            for inner in value:
                look(inner)

    look(schema)
    return found


def _table(entry: Schema) -> list[str]:
    """One row a key."""
    needed, rows = set(entry.get("required", ())), []
    for key, value in entry.get("properties", {}).items():
        name = f"**`{key}`**" if key in needed else f"`{key}`"
        default = "" if key in needed else _default(value)
        rows.append(f"| {name} | {_kind(value)} | {default} | {_cell(value.get('description', ''))} |")
    return ["| key | takes | default | |", "|---|---|---|---|", *rows, ""] if rows else []


def _default(value: Schema) -> str:
    found = value.get("default")
    # The defaults of a table stand with its own keys.
    return "" if found is None or found == "" or isinstance(found, Mapping) else f"`{_toml(found)}`"


def _toml(value: Any) -> str:
    """A value, no table, as TOML has it."""
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


def _kind(value: Schema) -> str:
    """What a key takes, in words."""
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    for union in ("oneOf", "anyOf"):
        if union in value:
            kinds = [_kind(one) for one in value[union] if one.get("type") != "null"]
            return " or ".join(dict.fromkeys(kinds))
    if "const" in value or "enum" in value:
        return " or ".join(f"`{_toml(one)}`" for one in value.get("enum", [value.get("const")]))
    return _plain(value)


def _plain(value: Schema) -> str:
    """The same of a single value, a list or a table."""
    kind = value.get("type")
    if kind in ("number", "integer"):
        return ("whole number" if kind == "integer" else "number") + ",".join(_limits(value))
    if kind == "string":
        return TEXTS.get(value.get("pattern", ""), "text")
    if kind == "boolean":
        return "`true` or `false`"
    if kind == "array" and "prefixItems" in value:
        return "[" + ", ".join(map(_kind, value["prefixItems"])) + "]"
    if kind == "array":
        return f"list of {_kind(value['items'])}"
    inner = next(iter(value.get("patternProperties", {}).values()), value.get("additionalProperties"))
    return f"NAME = {_kind(inner)}" if isinstance(inner, Mapping) and inner else "table"


def _limits(value: Schema) -> Iterator[str]:
    signs = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}
    yield from (f" {sign} {value[key]:g}" for key, sign in signs.items() if key in value)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
