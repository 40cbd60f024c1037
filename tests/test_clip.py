"""What is drawn: cells that belong together share points, sides of an interface do not."""

from __future__ import annotations

import numpy as np
import pytest

from phantomnode.pipeline.case import case_from_table
from phantomnode.pipeline.clip import ClippedBodies
from phantomnode.pipeline.prepare import prepare

SLANTED = {
    "kind": "mapped",
    "bottom": {"polyline": {"points": [[-0.2, -0.1], [1.3, -0.2]]}},
    "right": {"polyline": {"points": [[1.3, -0.2], [1.2, 1.2]]}},
    "top": {"polyline": {"points": [[-0.1, 1.1], [1.2, 1.2]]}},
    "left": {"polyline": {"points": [[-0.2, -0.1], [-0.1, 1.1]]}},
    "counts": [13, 11],
}


@pytest.mark.parametrize("relocation", [0.0, 0.1])
def test_the_outline_drawn_is_the_boundary_and_both_sides_of_interfaces(relocation: float) -> None:
    """On slanted cells cut corners lie beside the edge by the lattice (2e-7 h), and are one point all the same."""
    table = {
        "time": {"end": 1e-3},
        "relocation": {"distance": relocation},
        "material": {"soft": {"E": 1e9, "nu": 0.3, "rho": 1000.0}},
        "body": {
            "block": {
                "geometry": {"rectangle": {"low": [0.0, 0.0], "high": [1.0, 1.0]}},
                "grid": SLANTED,
                "material": "soft",
            }
        },
        "interface": {
            "joint": {"body": "block", "geometry": {"polyline": {"points": [[0.0, 0.4], [1.0, 0.61]]}}}
        },
    }
    prepared = prepare(case_from_table(table))
    clipped = ClippedBodies.of(prepared)
    points = clipped.interpolate(prepared.model.x)
    ends = points[clipped.outline()]
    length = np.hypot(*(ends[:, 1] - ends[:, 0]).T).sum()
    assert length == pytest.approx(4.0 + 2.0 * np.hypot(1.0, 0.21), rel=1e-5)
