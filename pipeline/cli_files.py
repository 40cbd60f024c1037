"""The commands about geometry files and new cases: ``phantomnode inspect | new``."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

from phantomnode.geometry.limits import LONGEST, TIME_LIMIT
from phantomnode.pipeline.console import DONE, guarded

if TYPE_CHECKING:
    from rich.console import Console

UnitOption = Annotated[
    str | None,
    Parameter(help='Unit of the numbers in the file ("mm", "m", "in", ...); the file\'s own unless given.'),
]
Layers = Annotated[
    tuple[str, ...],
    Parameter(
        name="--layer", negative=(), show_default=False,
        help='A layer of a DXF drawing that alone counts, by name or pattern ("cut*"); can be repeated.',
    ),
]  # fmt: skip
WithoutLayers = Annotated[
    tuple[str, ...],
    Parameter(
        name="--without-layer", negative=(), show_default=False,
        help="A layer of a DXF drawing that does not count; can be repeated.",
    ),
]  # fmt: skip
FaceOption = Annotated[
    str | None, Parameter(name="--face", help="Name or number of the flat face of a 3D part to take.")
]
SectionOption = Annotated[
    str | None,
    Parameter(name="--section", help='Where to cut the solids of a 3D part, in metres: "z=0.005".'),
]
Trust = Annotated[
    bool,
    Parameter(negative=(), show_default=False, help="Run commands in a .geo script (it can do anything)."),
]
TimeLimit = Annotated[
    float,
    Parameter(help="Give up reading the file after so many seconds.", validator=Number(gt=0.0, lte=LONGEST)),
]


def inspect(
    file: Annotated[
        Path, Parameter(name="FILE", help="DXF, SVG, STEP, IGES, BREP, XAO, .geo, .msh, WKT or GeoJSON.")
    ],
    /,
    *,
    unit: UnitOption = None,
    layer: Layers = (),
    without_layer: WithoutLayers = (),
    face: FaceOption = None,
    section: SectionOption = None,
    trust_scripts: Trust = False,
    time_limit: TimeLimit = TIME_LIMIT,
    out: Annotated[
        Path | None, Parameter(help="The picture, a .png file; results/inspect/FILE.png unless given.")
    ] = None,
) -> int:
    """Print what is in a geometry file and draw it: layers, regions, curves, sizes, what was mended, what is wrong.

    For example:

    ```
    phantomnode inspect part.dxf
    phantomnode inspect part.dxf --unit mm --without-layer "dim*"
    phantomnode inspect part.step --section z=0.005
    ```
    """

    def command(console: Console) -> int:
        from phantomnode.pipeline.cad_picture import draw_geometry
        from phantomnode.pipeline.files import make_folder
        from phantomnode.pipeline.inspection import inspect_file, report

        found = inspect_file(
            file, unit, layers=layer, without_layers=without_layer, trust_scripts=trust_scripts,
            time_limit=time_limit, **_part(face, section),
        )  # fmt: skip
        picture = out or Path("results") / "inspect" / f"{file.name}.png"
        make_folder(picture.parent)
        draw_geometry(found.geometry, picture, file.name, "" if found.has_unit else "units of the file")
        console.print(report(found), highlight=False)
        console.print(f"picture   {picture}", soft_wrap=True, highlight=False)
        return DONE

    return guarded(command)


def new(
    name: Annotated[str, Parameter(name="NAME", help="The folder to make; its last part names the case.")],
    /,
    *,
    from_: Annotated[
        Path | None,
        Parameter(name="--from", help="A geometry file to write the case for; it is copied into the folder."),
    ] = None,
    unit: UnitOption = None,
    layer: Layers = (),
    without_layer: WithoutLayers = (),
    face: FaceOption = None,
    section: SectionOption = None,
    time_limit: TimeLimit = TIME_LIMIT,
) -> int:
    """Write a commented starter case: a disc from a DXF drawing falls on a block, or your drawing falls on a plane.

    For example:

    ```
    phantomnode new my_case && phantomnode run my_case
    phantomnode new my_part --from part.dxf --unit mm && phantomnode check my_part
    ```
    """

    def command(console: Console) -> int:
        from shlex import quote

        if from_ is None:
            from phantomnode.pipeline.starter import write_starter

            if unit or layer or without_layer or face or section:
                from phantomnode.pipeline.errors import CaseError

                raise CaseError(
                    "--unit, --layer, --without-layer, --face and --section belong to a file: give it with --from"
                )
            folder, copied = write_starter(Path(name)), "disc.dxf"
        else:
            from phantomnode.pipeline.adoption import write_case_for

            part = _part(face, section)
            folder = write_case_for(
                Path(name), from_, unit, layer, without_layer, **part, time_limit=time_limit
            )
            copied = from_.name
        console.print(f"Wrote {folder / 'case.toml'} and {folder / copied}.", highlight=False, soft_wrap=True)
        then = "run" if from_ is None else "check"
        console.print(f"Next:  phantomnode {then} {quote(name)}", highlight=False, soft_wrap=True)
        return DONE

    return guarded(command)


def _part(face: str | None, section: str | None) -> dict[str, Any]:
    """What to take of a 3D part, as readers take it."""
    from phantomnode.pipeline.errors import CaseError

    if face and section:
        raise CaseError("--face and --section are both given; give the one to take")
    place = re.fullmatch(r"\s*([xyz])\s*=\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*", section or "")
    if section and place is None:
        raise CaseError(f"--section {section}: must be an axis and a place on it in metres, such as z=0.005")
    number = int(face) if face and face.isdecimal() else face
    return {"face": number, "section": (place[1], float(place[2])) if place else None}
