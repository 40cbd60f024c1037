"""Names of folders made of the values of a case: readable, safe on any file system, unlike each other."""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

LONGEST = 120
"""Characters of a name; file systems take 255 bytes, and paths of 260 characters are a limit on some."""


def unique_names(choices: Sequence[Mapping[str, Any]]) -> list[str]:
    """A name for each case: "speed=-50_penalty=100".

    Names that would be the same (also where capitals do not count), and those that are too long, end with six
    digits of the hash of their values.

    Parameters
    ----------
    choices : sequence of mapping
        The values of each case by the names of the axes.
    """
    plain = ["_".join(f"{axis}={word(value)}" for axis, value in values.items()) for values in choices]
    times = Counter(name.lower() for name in plain)
    return [
        f"{name[:LONGEST]}~{_short_hash(values)}" if times[name.lower()] > 1 or len(name) > LONGEST else name
        for name, values in zip(plain, choices, strict=True)
    ]


def said(value: Any) -> str:
    """A value for people to read: a name as it was given, numbers and lists as in the names of folders."""
    return value if isinstance(value, str) else word(value)


def word(value: Any) -> str:
    """A value as part of a name; six significant digits of a number."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        return "+".join(f"{key}-{word(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return "+".join(word(item) for item in value)
    return re.sub(r"[^A-Za-z0-9.+-]", "-", str(value)).rstrip(".") or "-"


def _short_hash(values: Mapping[str, Any]) -> str:
    """Six hexadecimal digits."""
    return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()[:6]
