"""Units of length, and where a file says which one its numbers have."""

from __future__ import annotations

import difflib
import re

from phantomnode.geometry.errors import GeometryError, NoUnitError

METRES = {
    "m": 1.0,
    "dm": 1e-1,
    "cm": 1e-2,
    "mm": 1e-3,
    "um": 1e-6,
    "nm": 1e-9,
    "km": 1e3,
    "in": 0.0254,
    "ft": 0.3048,
    "yd": 0.9144,
    "mi": 1609.344,
    "mil": 2.54e-5,
    "uin": 2.54e-8,
}
"""Metres in one of each unit."""

SPELLED = {
    "metre": "m", "meter": "m", "millimetre": "mm", "millimeter": "mm", "centimetre": "cm", "centimeter": "cm",
    "micrometre": "um", "micrometer": "um", "micron": "um", "kilometre": "km", "inch": "in", "inches": "in",
    "foot": "ft", "feet": "ft", "yard": "yd", "mile": "mi", "thou": "mil",
}  # fmt: skip
"""What is meant by longer words."""

INSUNITS = {
    1: "in", 2: "ft", 3: "mi", 4: "mm", 5: "cm", 6: "m", 7: "km", 8: "uin",
    9: "mil", 10: "yd", 12: "nm", 13: "um", 14: "dm",
}  # fmt: skip
"""The unit of each code of $INSUNITS (DXF reference, header variables)."""

LIKELY = (1e-4, 200.0)
"""Sizes of parts in contact, m, that raise no question."""

_IGES_FLAGS = {1: "in", 2: "mm", 4: "ft", 5: "mi", 6: "m", 7: "km", 8: "mil", 9: "um", 10: "cm", 11: "uin"}
_SI_PREFIXES = {
    "$": "m",
    ".MILLI.": "mm",
    ".CENTI.": "cm",
    ".DECI.": "dm",
    ".MICRO.": "um",
    ".NANO.": "nm",
    ".KILO.": "km",
}
_STEP_NAMES = {"INCH": "in", "IN": "in", "FOOT": "ft", "FEET": "ft", "FT": "ft", "YARD": "yd",
               "MILE": "mi",
               "MIL": "mil", "MILLIMETRE": "mm", "MM": "mm", "METRE": "m", "M": "m", "CENTIMETRE": "cm"}  # fmt: skip


def metres(unit: str) -> float:
    """Metres in one ``unit``.

    Raises
    ------
    GeometryError
        For a unit that is not in :data:`METRES`, naming the nearest one.
    """
    if unit in METRES:
        return METRES[unit]
    near = difflib.get_close_matches(unit.lower(), [*METRES, *SPELLED], n=1, cutoff=0.5)
    hint = f"; did you mean '{SPELLED.get(near[0], near[0])}'?" if near else ""
    raise GeometryError(f"unknown unit of length '{unit}'{hint} (one of {', '.join(METRES)})")


def chosen(given: str | None, own: str | None, hint: str = "") -> tuple[str, tuple[str, ...]]:
    """The unit to use and a note: the given one goes before the file's own; one of the two must be there.

    Raises
    ------
    NoUnitError
        Where there is none, with the hint.
    """
    if given is not None:
        metres(given)
        if own is not None and metres(own) != metres(given):
            return given, (f"the file says its unit is {own}; read as {given}, as asked",)
        return given, ()
    if own is not None:
        return own, ()
    raise NoUnitError(
        f"the file does not say in which unit its numbers are{f' ({hint})' if hint else ''}; give one, e.g. "
        f'unit = "mm" (one of {", ".join(METRES)})'
    )


def size_note(size: float, unit: str) -> str | None:
    """A warning where a drawing of this size, m, was hardly meant in its unit; None where it may well be."""
    if size == 0.0 or LIKELY[0] <= size <= LIKELY[1]:
        return None
    raw = size / metres(unit)
    others = [
        name for name in ("mm", "in", "m") if LIKELY[0] <= raw * metres(name) <= LIKELY[1] and name != unit
    ]
    instead = " or ".join(f"{raw * metres(name):.4g} m in {name}" for name in others)
    return (
        f"the drawing is {size:.4g} m across, read in {unit}: is that so?"
        f"{f' It would be {instead}: give the unit then' if instead else ''}"
    )


def step_unit(text: str) -> str | None:
    """The unit of length of a STEP file; None where it has none.

    Raises
    ------
    GeometryError
        Where its contexts disagree, so that "the unit" means nothing, or where it is not known here.
    """
    compact = re.sub(r"\s+", "", text.upper())
    entities = dict(re.findall(r"(#\d+)=([^;]*);", compact))
    units = set()
    for used in re.findall(r"GLOBAL_UNIT_ASSIGNED_CONTEXT\(\(([#\d,]*)\)\)", compact):
        for body in (entities.get(reference, "") for reference in used.split(",")):
            if "LENGTH_UNIT()" in body:
                units.add(_step_unit_name(body))
    if not units:
        return None
    if len(units) > 1 or not units <= METRES.keys():
        raise GeometryError(
            f"cannot tell the unit of this STEP file ({', '.join(sorted(units))}); export it in mm or m"
        )
    return units.pop()


def _step_unit_name(body: str) -> str:
    """The name of one STEP length unit: converted ('INCH') or SI with a prefix; as written where unknown."""
    converted = re.search(r"CONVERSION_BASED_UNIT\('([^']*)'", body)
    if converted:
        return _STEP_NAMES.get(converted.group(1), converted.group(1))
    si = re.search(r"SI_UNIT\((\$|\.\w+\.),\.METRE\.\)", body)
    return _SI_PREFIXES.get(si.group(1), si.group(1)) if si else body


def iges_unit(text: str) -> str | None:
    """The unit of length of an IGES file, from its global section (field 14); None where the field is empty."""
    section = "".join(line[:72].ljust(72) for line in text.splitlines() if len(line) > 72 and line[72] == "G")
    fields = _iges_fields(section)
    flag = fields[13].strip() if len(fields) > 13 else ""
    if not flag:
        return None
    if not flag.isdigit() or int(flag) not in _IGES_FLAGS:
        raise GeometryError(f"unit flag '{flag}' of this IGES file is not known; export it in mm or m")
    return _IGES_FLAGS[int(flag)]


def _iges_fields(section: str) -> list[str]:
    """The fields of an IGES global section; strings are written as 3Habc, and the first field is the delimiter."""
    delimiter = section[2] if section.startswith("1H") else ","
    fields, position, start = [], 0, 0
    while position < len(section):
        hollerith = re.match(r"\s*(\d+)H", section[position:]) if position == start else None
        if hollerith:
            position += hollerith.end() + int(hollerith.group(1))
        elif section[position] in (delimiter, ";"):
            fields.append(section[start:position])
            position = start = position + 1
        else:
            position += 1
    return fields
