"""A run of a second, for tests of what is made from results: a coarse disc with a hole falls on a floor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from phantomnode.pipeline.case import case_from_table
from phantomnode.pipeline.run import run

TABLE: dict[str, Any] = {
    "title": "A <small> disc & a floor",
    "time": {"end": 1.2e-3},
    "material": {"rubber": {"E": 50e6, "nu": 0.45, "rho": 1100.0}},
    "body": {
        "disc": {
            "geometry": {"ring": {"centre": [0.0, 0.0205], "outer": 0.02, "inner": 0.006}},
            "grid": {"kind": "cartesian", "cell": 0.003},
            "material": "rubber",
            "initial_velocity": [0.0, -5.0],
        },
        "floor": {
            "geometry": {"rectangle": {"low": [-0.03, -0.01], "high": [0.03, 0.0]}},
            "grid": {"kind": "cartesian", "cell": 0.005, "aligned": True},
            "material": "rubber",
        },
    },
    "contact": {"landing": {"slave": "disc.outer", "master": "floor.top"}},
    "boundary": {"base": {"on": "floor.bottom", "displacement": {"x": 0.0, "y": 0.0}}},
    "output": {"fields": {"count": 6}, "history": {"count": 60}},
}


def small_run(folder: Path, table: dict[str, Any] = TABLE) -> Path:
    """Run it, or a case like it, into a folder."""
    summary = run(case_from_table(table, folder.parent, "small"), folder)
    assert summary.status == "done"
    return folder
