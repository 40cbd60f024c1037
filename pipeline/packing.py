"""Arrays as text for a page: little-endian bytes, packed by gzip, in base64."""

from __future__ import annotations

import gzip
from base64 import b64encode
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Packed = dict[str, Any]

STEPS = 65535
"""Of a quantised array: 1.5e-5 of its range each, far below a pixel or a shade."""


def packed(values: NDArray[np.generic]) -> Packed:
    """An array as its type ("u2", "f4", ...), shape and bytes.

    The bytes stand by significance, all lowest ones first: gzip packs them better so.
    """
    array = np.ascontiguousarray(values.astype(values.dtype.newbyteorder("<")))
    planes = array.reshape(-1).view(np.uint8).reshape(-1, array.dtype.itemsize).T
    text = b64encode(gzip.compress(np.ascontiguousarray(planes).tobytes(), 6, mtime=0)).decode()
    return {"type": array.dtype.str[1:], "shape": list(array.shape), "data": text}


def quantised(values: Floats, low: Floats | float, high: Floats | float) -> NDArray[np.uint16]:
    """Values as steps, 0..65535, between two bounds or those of each column; what lies beyond is put on them."""
    width = np.where(np.asarray(high) > low, np.asarray(high) - low, 1.0)
    return np.round(np.clip((values - low) / width, 0.0, 1.0) * STEPS).astype(np.uint16)
