"""Geometry as what JSON takes, and back; nothing but geometry can come of it."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from phantomnode.geometry.curves import Contents, Curve, Geometry, Region
from phantomnode.geometry.findings import Finding

_CLASSES: dict[str, Any] = {cls.__name__: cls for cls in (Geometry, Region, Curve, Contents, Finding)}


def encoded(value: Any) -> Any:
    """Dataclasses as tables with their name, arrays as tables with their type, tuples as lists; floats to the bit."""
    if is_dataclass(value):
        return {
            "class": type(value).__name__,
            **{f.name: encoded(getattr(value, f.name)) for f in fields(value)},
        }
    if isinstance(value, np.ndarray):
        return {"array": value.tolist(), "type": str(value.dtype), "shape": value.shape}
    return [encoded(item) for item in value] if isinstance(value, tuple | list) else value


def decoded(value: Any) -> Any:
    """The inverse of :func:`encoded`; lists come back as tuples."""
    if isinstance(value, dict) and "class" in value:
        known = _CLASSES[value["class"]]
        return known(**{key: decoded(item) for key, item in value.items() if key != "class"})
    if isinstance(value, dict):
        return np.array(value["array"], dtype=value["type"]).reshape(value["shape"])
    return tuple(map(decoded, value)) if isinstance(value, list) else value
