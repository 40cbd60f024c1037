"""Exceptions for geometry that cannot be used."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phantomnode.geometry.curves import Geometry


class GeometryError(ValueError):
    """A curve, file or grid cannot be used; the message says which, what is wrong and what to do."""


class NoUnitError(GeometryError):
    """Neither the file nor the user says in which unit the numbers of the file are."""


class OutlineError(GeometryError):
    """A drawing was read, but its curves make no outline that could be used.

    Attributes
    ----------
    geometry : Geometry
        What was read, to be drawn.
    """

    def __init__(self, message: str, geometry: Geometry) -> None:
        super().__init__(message)
        self.geometry = geometry
