"""The fields that can be drawn: their names, what they are called, their units, and how to get them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.messages import listed, suggestion

if TYPE_CHECKING:
    from phantomnode.pipeline.frames import FieldsFrame

Floats = NDArray[np.float64]

PLANE = ("XX", "YY", "ZZ", "XY")
"""The first components of a symmetric tensor in VTK's order; the others are zero in plane strain."""


class Quantity(NamedTuple):
    """A field of the bodies.

    label, unit: what it is called, SI; kind: a magnitude begins at zero, a signed one is drawn about zero, a ratio
    about one; values: (m,) of each cell of a frame.
    """

    label: str
    unit: str
    kind: Literal["magnitude", "signed", "ratio"]
    values: Callable[[FieldsFrame], Floats]


def _cells(name: str, component: int | None = None) -> Callable[[FieldsFrame], Floats]:
    """A cell array of the files, or one of its components."""
    return lambda frame: frame.cell(name) if component is None else frame.cell(name)[:, component]


def _points(name: str, component: int | None = None) -> Callable[[FieldsFrame], Floats]:
    """Magnitude or component of a point array, as the mean over the corners of each cell."""

    def values(frame: FieldsFrame) -> Floats:
        vector = frame.point(name)[:, :2]
        return frame.means(np.hypot(*vector.T) if component is None else vector[:, component])

    return values


def _mean_stress(frame: FieldsFrame) -> Floats:
    return np.asarray(frame.cell("stress")[:, :3].mean(axis=1))


def _principal(sign: float) -> Callable[[FieldsFrame], Floats]:
    """The larger or smaller principal stress in the plane."""

    def values(frame: FieldsFrame) -> Floats:
        xx, yy, _, xy = frame.cell("stress")[:, :4].T
        return np.asarray(0.5 * (xx + yy) + sign * np.hypot(0.5 * (xx - yy), xy))

    return values


QUANTITIES: dict[str, Quantity] = {
    "von_mises": Quantity("von Mises stress", "Pa", "magnitude", _cells("von_mises")),
    **{
        f"stress_{name.lower()}": Quantity(f"stress {name.lower()}", "Pa", "signed", _cells("stress", k))
        for k, name in enumerate(PLANE)
    },
    "mean_stress": Quantity("mean stress", "Pa", "signed", _mean_stress),
    "principal_max": Quantity("larger principal stress in the plane", "Pa", "signed", _principal(1.0)),
    "principal_min": Quantity("smaller principal stress in the plane", "Pa", "signed", _principal(-1.0)),
    **{
        f"strain_{name.lower()}": Quantity(
            f"Hencky strain {name.lower()}", "", "signed", _cells("hencky_strain", k)
        )
        for k, name in enumerate(PLANE)
        if name != "ZZ"
    },
    "J": Quantity("J = det F", "", "ratio", _cells("J")),
    "displacement": Quantity("displacement, magnitude", "m", "magnitude", _points("displacement")),
    "displacement_x": Quantity("displacement x", "m", "signed", _points("displacement", 0)),
    "displacement_y": Quantity("displacement y", "m", "signed", _points("displacement", 1)),
    "velocity": Quantity("velocity, magnitude", "m/s", "magnitude", _points("velocity")),
    "velocity_x": Quantity("velocity x", "m/s", "signed", _points("velocity", 0)),
    "velocity_y": Quantity("velocity y", "m/s", "signed", _points("velocity", 1)),
}
"""All fields by the names that the command line knows."""


def quantity(name: str) -> Quantity:
    """A field by its name.

    Raises
    ------
    CaseError
        Naming the fields that there are.
    """
    if name not in QUANTITIES:
        raise CaseError(
            f"{name!r} is no field{suggestion(name, QUANTITIES)}; there are: {listed(QUANTITIES)}"
        )
    return QUANTITIES[name]
