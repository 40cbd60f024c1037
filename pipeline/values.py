"""The values that tables of the case file are made of: numbers, names, units, and the table itself.

Where a key takes a number or a text or a table, the kind of value decides which is meant, so that a message
speaks of that one only.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from phantomnode.geometry.units import metres
from phantomnode.pipeline import expressions

NAME_PATTERN = r"^[A-Za-z_][A-Za-z0-9_-]*$"
PLACE_PATTERN = r"^[A-Za-z_][A-Za-z0-9_-]*\.\S(.*\S)?$"
PLACE_OR_NAME_PATTERN = r"^[A-Za-z_][A-Za-z0-9_-]*(\.\S(.*\S)?)?$"

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0)]
Count = Annotated[int, Field(strict=True, ge=1)]
Switch = Annotated[bool, Field(strict=True)]
Vector = tuple[Number, Number]
Counts = tuple[Count, Count]
Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Place = Annotated[str, Field(pattern=PLACE_PATTERN)]
PlaceOrName = Annotated[str, Field(pattern=PLACE_OR_NAME_PATTERN)]


def kind_of_value(value: Any) -> str:
    """The tag of a value by what it is in TOML; tags start with "=", which no key does."""
    if isinstance(value, (dict, BaseModel)):
        return "=table"
    if isinstance(value, str):
        return "=text"
    return "=list" if isinstance(value, list | tuple) else "=number"


def kind_of_grid(value: Any) -> str:
    """The tag of a grid: its name, its kind, or a file."""
    if isinstance(value, str):
        return "=text"
    table = value if isinstance(value, dict) else vars(value) if isinstance(value, BaseModel) else {}
    return "=file" if "kind" not in table and "file" in table else f"={table.get('kind')}"


def expression_of(variable: str) -> AfterValidator:
    """Check that a text is an expression of the variable."""

    def check(text: str) -> str:
        expressions.parse(text, variable)
        return text

    return AfterValidator(check)


def _known_unit(unit: str) -> str:
    """The unit itself; an error that names the nearest one where it is not known."""
    metres(unit)
    return unit


Unit = Annotated[str, AfterValidator(_known_unit)]


class Table(BaseModel):
    """A table of the case file: unknown keys are refused, values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def exactly_one(self, *keys: str) -> str:
        """The one of these keys that is given; an error where none or several are."""
        given = [key for key in keys if getattr(self, key) is not None]
        if len(given) != 1:
            found = "none is" if not given else " and ".join(given) + " are"
            raise ValueError(f"exactly one of {', '.join(keys)} must be given, but {found} given")
        return given[0]
