"""``[figure.NAME]``: pictures of runs side by side or over each other, with their data."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from phantomnode.pipeline.values import Name, Number, Table, Vector

NEEDS = {"field": ("quantity", "times"), "pressure": ("times",), "history": ("columns",)}
"""What each kind cannot do without."""
ALLOWS = {
    "field": ("quantity", "times", "limits"),
    "pressure": ("pair", "times", "filtered", "origin", "curves"),
    "history": ("columns", "curves"),
}
TOTAL = "total"
"""The sum of all energies and dissipated work less the external work, beside the columns of history.csv."""

NotNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0)]


class Figure(Table):
    """A picture of a run with its variants, or of the cases of a sweep, and its data as CSV."""

    kind: Literal["field", "pressure", "history"] = Field(
        description='"field" on the deformed bodies, contact "pressure" along the slave surface, or "history"'
    )
    title: str = Field(default="", description="what stands above it; the title of the case unless given")
    where: dict[Name, Any] = Field(
        default={}, description="of a sweep, axes with a value or a list of values: the cases to show"
    )
    times: tuple[NotNegative, ...] = Field(
        default=(), description="s; the nearest frames are taken, so let output.fields.count meet them"
    )
    quantity: str | None = Field(
        default=None,
        description="of a field: stress_yy, von_mises, displacement_x, ... as for phantomnode plot",
    )
    limits: Vector | None = Field(
        default=None, description="[low, high] of the colours, SI; from the values unless given"
    )
    pair: Name | None = Field(default=None, description="name of a contact pair; the first unless given")
    filtered: Annotated[bool, Field(strict=True)] = Field(
        default=False, description="the pressure through the hat filter, not that of each segment"
    )
    origin: tuple[Number, Number] | None = Field(
        default=None,
        description="[x, y], m: where arc length counts from; the left end of the undeformed surface unless given",
    )
    columns: tuple[str, ...] = Field(
        default=(), description=f'of history.csv, and "{TOTAL}": all energies less the external work'
    )
    curves: Literal["cases", "times", "columns"] | None = Field(
        default=None,
        description='what the curves of a panel are: "cases", or the "times" or "columns" of one case; cases '
        "unless there is one only",
    )

    @model_validator(mode="after")
    def _fits_its_kind(self) -> Figure:
        given = self.model_fields_set - {"kind", "title", "where"}
        for key in NEEDS[self.kind]:
            if not getattr(self, key):
                raise ValueError(f'{key} must be given for kind = "{self.kind}"')
        for key in sorted(given - {*ALLOWS[self.kind]}):
            if getattr(self, key) != type(self).model_fields[key].default:  # a resolved case spells them out
                raise ValueError(
                    f'{key} is not for kind = "{self.kind}", which takes {", ".join(ALLOWS[self.kind])}'
                )
        if self.curves not in (None, "cases", "times" if self.kind == "pressure" else "columns"):
            raise ValueError(f'curves = "{self.curves}" is not for kind = "{self.kind}"')
        if self.limits is not None and self.limits[0] >= self.limits[1]:
            raise ValueError(f"limits = {list(self.limits)} must be [low, high] with low < high")
        return self
