"""Case files: everything that can be wrong has its own message, and what is right comes back unchanged."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from phantomnode.pipeline.case import (
    Case,
    CaseError,
    bundled_cases,
    case_from_table,
    json_schema,
    load_case,
    resolved_toml,
)
from phantomnode.pipeline.shapes import CartesianGrid, FileGrid, MappedGrid, PolarGrid

TEXT = """
title = "Two bodies"
time = { end = 1e-3 }

[material.steel]
E = 210e9
nu = 0.3
rho = 7800

[grid.shared]
kind = "cartesian"
cell = [0.1, 0.2]

[body.disc]
geometry = { circle = { centre = [0, 0], radius = 1 }, move = [0, 2] }
grid = "shared"
material = "steel"
initial_velocity = [0, -5]

[body.block]
geometry = { polygon = { points = [[0, 0], [1, 0], [1, 1]] } }
grid = { kind = "cartesian", counts = [10, 10], box = [[0, 0], [1, 1]] }
material = "steel"

[interface.mid]
body = "block"
geometry = { function = "0.5 + 0.05*sin(5*pi*x/2)" }

[contact.pair]
slave = "disc.outer"
master = "block.top"
penalty = { times_E = 100 }

[boundary.base]
on = "block.bottom"
velocity = { x = { t = [0, 1], value = [0, 1] }, y = "-t" }
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A sound case file."""
    path = tmp_path / "pair" / "case.toml"
    path.parent.mkdir()
    path.write_text(TEXT)
    return path


def test_a_case_is_read_with_its_defaults(file: Path) -> None:
    case = load_case(file)
    assert (case.name, case.folder, case.title) == ("pair", file.parent.resolve(), "Two bodies")
    assert (case.time.end, case.time.step, case.time.safety, case.time.force) == (1e-3, "auto", 0.85, False)
    assert (case.hourglass, case.relocation.distance, case.guard.energy_error) == (0.1, 0.1, 0.05)
    assert (case.output.fields.count, case.output.history.count, case.gravity) == (60, 2000, (0.0, 0.0))
    assert case.grid_of("disc") is case.grid["shared"]
    shared, own = case.grid_of("disc"), case.grid_of("block")
    assert isinstance(shared, CartesianGrid) and shared.spacing == (0.1, 0.2)
    assert isinstance(own, CartesianGrid) and own.spacing is None and own.counts == (10, 10)
    assert case.body["disc"].initial_velocity == (0.0, -5.0)


@pytest.mark.parametrize(
    ("override", "fragment"),
    [
        # elements, damping, mass scaling
        ("method='xfem'", r'method = "xfem": classic X-FEM runs without contact'),
        ("integration.cut=2", r"integration\.cut = 2: must be 3 or 1"),
        ("integration.cut=true", r"integration\.cut"),
        ("integration.uncut='both'", r'integration\.uncut = .both.: must be "one-point" or "full"'),
        ("integration.alpha=0.5", r"integration\.alpha = 0\.5: must be at least 1"),
        ("integration.alpha_below=2", r"integration\.alpha_below = 2: must be at most 1"),
        ("hourglass={}", r"hourglass.*stiffness or viscosity must be given"),
        ("hourglass={stifness=0.1}", r"hourglass\.stifness: unknown key.*did you mean 'stiffness'"),
        ("hourglass='soft'", r"hourglass = .soft."),
        ("hourglass=-0.1", r"hourglass = -0\.1: must be at least 0"),
        ("damping.mass=-1", r"damping\.mass = -1: must be at least 0"),
        ("damping.bulk_viscosity=0.06", r"damping\.bulk_viscosity = 0\.06"),
        ("damping.bulk_viscosity.cubic=1", r"damping\.bulk_viscosity\.cubic: unknown key"),
        ("mass_scaling={}", r"mass_scaling\.step: is missing"),
        ("mass_scaling.step=0", r"mass_scaling\.step = 0: must be greater than 0"),
        # names of keys
        ("tim.end=1", r"unknown key 'tim' \(did you mean 'time'\?\); a case knows title, name"),
        (
            "time.ende=1",
            r"time\.ende: unknown key \(did you mean 'end'\?\); time knows end, step, safety, force",
        ),
        ("body.disc.velocity=[0,1]", r"body\.disc\.velocity: unknown key.*knows geometry, grid, material"),
        ("body.disk.material=steel", r"no body 'disk' \(did you mean 'disc'\?\); this case has disc, block"),
        ("contact.pair.penalty={times_e=3}", r"penalty\.times_e: unknown key \(did you mean 'times_E'\?\)"),
        (
            "body.block.grid={kind='polar',centre=[0,0],radii=[1,2],counts=[9,9],cell=1}",
            r"block\.grid\.cell: unknown",
        ),
        ("body.new={}", r"body\.new\.geometry: is missing; add it"),
        ("body.1a={}", r"body: '1a' cannot be a name; use letters"),
        # kinds of values
        ("time.end=soon", r'time\.end = "soon": must be a number \(end of the run, s\)'),
        ("time.end=nan", r"time\.end = nan: must be a finite number"),
        ("time.force=1", r"time\.force = 1: must be true or false"),
        ("time.step=fast", r'time\.step = "fast": must be "auto"'),
        ("time.step=[1]", r"time\.step = \[1\]: must be text in quotes or a number"),
        ("output.fields.count=1.5", r"fields\.count = 1\.5: must be a whole number"),
        ("title=3", r"title = 3: must be text"),
        ("body.disc=3", r"body\.disc = 3: must be a table"),
        ("body.disc.initial_velocity=[0]", r"initial_velocity = \[0\]: needs 2 entries \(\[vx, vy\], m/s\)"),
        ("body.disc.initial_velocity=[0,1,2]", r"at most 2 entries, not 3"),
        ("body.disc.initial_velocity=[0,'fast']", r'initial_velocity\.1 = "fast": must be a number'),
        ("body.disc.initial_velocity=5", r"initial_velocity = 5: must be a list"),
        ("contact.pair.penalty=1e12", r"penalty = 1000000000000\.0: must be text in quotes or a table"),
        ("body.block.grid=3", r"block\.grid = 3: needs kind = "),
        # limits
        ("time.end=0", r"time\.end = 0: must be greater than 0"),
        ("time.end=-1", r"time\.end = -1: must be greater than 0"),
        ("time.safety=1.1", r"time\.safety = 1\.1: must be at most 1"),
        ("material.steel.rho=-7800", r"rho = -7800: must be greater than 0 \(density, kg/m\^3\)"),
        ("material.steel.E=0", r"E = 0: must be greater than 0 \(Young's modulus, Pa\)"),
        ("material.steel.nu=0.5", r"material\.steel: nu = 0\.5 is incompressible"),
        ("material.steel.nu=0.6", r"nu = 0\.6 must lie between -1 and 0\.5"),
        ("material.steel.nu=-1", r"nu = -1 must lie between"),
        ("relocation.distance=0.5", r"relocation\.distance = 0\.5: must be less than 0\.5"),
        ("output.history.count=0", r"history\.count = 0: must be at least 1"),
        ("body={}", r"body = \{\}: needs at least 1 entry"),
        # grids
        ("body.block.grid={kind='cartesion'}", r"did you mean 'cartesian'"),
        (
            "body.block.grid.cell=0.1",
            r"block\.grid: exactly one of cell, counts must be given, but cell and counts",
        ),
        ("body.block.grid.box=[[0,0],[0,1]]", r"box must be \[\[left, bottom\]"),
        ("body.block.grid.counts=[0,4]", r"counts\.0 = 0: must be at least 1"),
        ("grid.shared.cell=-0.1", r"grid\.shared\.cell = -0\.1: must be greater than 0"),
        ("body.block.grid={kind='polar',centre=[0,0],radii=[2,1],counts=[9,9]}", r"inner < outer"),
        (
            "body.block.grid={kind='polar',centre=[0,0],radii=[1,2],angles=[0,400],counts=[9,9]}",
            r"at most 360",
        ),
        ("body.block.grid={file='quads.msh'}", r'block\.grid\.file = "quads\.msh": there is no such file'),
        ("body.disc.grid=shred", r"no grid 'shred' \(did you mean 'shared'\?\)"),
        # geometry
        (
            "body.disc.geometry={}",
            r"exactly one of file, rectangle, circle, ring, polygon must be given, but none",
        ),
        ("body.disc.geometry.ring={centre=[0,0],outer=2,inner=1}", r"circle and ring are given"),
        (
            "body.disc.geometry={ring={centre=[0,0],outer=1,inner=2}}",
            r"inner = 2 must be smaller than outer = 1",
        ),
        ("body.disc.geometry={rectangle={low=[1,0],high=[0,1]}}", r"must lie below and left of high"),
        ("body.disc.geometry.unit=mm", r"unit belongs to a file"),
        (
            "body.disc.geometry={file='a.dxf',unit='parsec'}",
            r"geometry\.unit: unknown unit of length 'parsec'",
        ),
        (
            "body.disc.geometry={file='a.dxf',unit='mm'}",
            r'disc\.geometry\.file = "a\.dxf": there is no such file in',
        ),
        ("body.block.geometry.polygon.points=[[0,0],[1,0]]", r"needs at least 3 entries, not 2"),
        ("body.block.geometry.polygon.points.2=[1]", r"points\.2 = \[1\]: needs 2 entries"),
        ("body.disc.geometry.scale=0", r"geometry\.scale = 0: must be greater than 0"),
        ("interface.mid.geometry.function=x.y", r"function: 'x\.y': a dot"),
        ("interface.mid.geometry.function=sin(t)", r"unknown name 't'"),
        ("interface.mid.geometry={circle={centre=[0,0],radius=1},x=[0,1]}", r"x belongs to a function"),
        # names between tables
        ("body.disc.material=stel", r"no material 'stel' \(did you mean 'steel'\?\)"),
        ("interface.mid.body=blok", r'interface\.mid\.body = "blok": there is no body'),
        (
            "interface.disc={body='block',geometry={function='x'}}",
            r"interface\.disc: a body has this name too",
        ),
        ("contact.pair.slave=disk.outer", r"no body or interface 'disk' \(did you mean 'disc'\?\)"),
        ("contact.pair.slave=disc", r'must be "NAME\.PART"'),
        ("contact.pair.master=mid.top", r"the sides of an interface are mid\.plus and mid\.minus"),
        (
            "contact.pair={slave='mid.plus',master='mid.plus'}",
            r"a side of an interface, which cannot touch itself",
        ),
        ("contact.pair.master=floor", r"there is no body or interface 'floor'"),
        ("contact.pair.master=block", r"name a part of it, as in \"block\.outer\""),
        ("contact.pair={slave='disc.outer',master='disc.outer',passes=2}", r"self contact tests every point"),
        ("contact.pair.friction=-0.1", r"contact\.pair\.friction = -0\.1: must be at least 0"),
        (
            "contact.pair.tangential_penalty={value=0}",
            r"tangential_penalty\.value = 0: must be greater than 0",
        ),
        ("contact.pair.tangential_penalty=soft", r'tangential_penalty = "soft": must be "auto"'),
        ("contact.pair.passes=3", r"contact\.pair\.passes = 3: must be at most 2"),
        ("contact.pair.points.rule=simpson", r'"gauss" or "newton-cotes"'),
        ("contact.pair.points={rule='newton-cotes',count=2}", r"the ends of the segment alone"),
        ("contact.pair.points={rule='newton-cotes',count=9}", r"negative weights"),
        ("contact.pair.points.count=0", r"points\.count = 0: must be at least 1"),
        # rigid obstacles
        (
            "rigid.wall={geometry={polyline={points=[[0,0],[1,0]]}}}",
            r"rigid\.wall: no contact has it as its master",
        ),
        (
            "rigid.disc={geometry={circle={centre=[0,0],radius=1}}}",
            r"rigid\.disc: there is a body of this name",
        ),
        ("rigid.wall={geometry={function='x'}}", r"a function needs its range"),
        (
            "rigid.wall={geometry={file='a.dxf'}}",
            r'rigid\.wall\.geometry\.file = "a\.dxf": there is no such file',
        ),
        ("rigid.wall={geometry={polyline={points=[[0,0],[1,0]]}},side='up'}", r'"left" or "right"'),
        (
            "rigid.wall={geometry={polyline={points=[[0,0],[1,0]]}},displacement={x=0},velocity={y=1}}",
            r"displacement and velocity are both given",
        ),
        (
            "rigid.wall={geometry={polyline={points=[[0,0],[1,0]]}},displacement={y='1-t'}}",
            r"rigid\.wall\.displacement\.y: the displacement at t = 0 is 1 m",
        ),
        ("contact.pair.overlap=ofset", r'"refuse" or "offset" \(did you mean \'offset\'\?\)'),
        (
            "boundary.base.on={body='b',box=[[0,0],[1,1]]}",
            r"boundary\.base\.on\.body = \"b\": there is no body",
        ),
        ("boundary.base.on={body='block'}", r"boundary\.base\.on\.box: is missing"),
        # prescribed motions
        ("boundary.base.velocity={}", r"boundary\.base\.velocity: x or y or both"),
        ("boundary.base.displacement={x=0}", r"exactly one of displacement, velocity, acceleration"),
        ("boundary.base.velocity.y=1/t", r"boundary\.base\.velocity\.y: '1/t' is inf at t = 0"),
        ("boundary.base.velocity.y=__import__('os')", r"velocity\.y: .*unknown function '__import__'"),
        ("boundary.base.velocity.x={t=[0,0],value=[0,1]}", r"velocity\.x: t = \[0\.0, 0\.0\] must increase"),
        ("boundary.base.velocity.x={t=[0],value=[0,1]}", r"1 times t but 2 values"),
        ("boundary.base={on='block.top',displacement={y='t-1'}}", r"displacement at t = 0 is -1 m"),
        # overrides themselves
        ("time.end", r"write key\.path=value"),
        ("=3", r"write key\.path=value"),
        ("gravity=[0,-9.81] extra", r'gravity = "\[0,-9\.81\] extra": must be a list'),
        ("time.end.x=3", r"time\.end is 0\.001, which has no keys"),
        (
            "body.disc.grid.cell=3",
            r'body\.disc\.grid is "shared", which has no keys; set body\.disc\.grid as a whole',
        ),
        ("body.disc.initial_velocity.2=1", r"has places 0 to 1, not '2'"),
    ],
)
def test_bad_input_has_its_own_message(file: Path, override: str, fragment: str) -> None:
    with pytest.raises(CaseError, match=fragment) as caught:
        load_case(file, [override])
    # The reader is told where: the file, or the option.
    assert all(message.startswith((str(file), "--set")) for message in caught.value.messages)


@pytest.mark.parametrize(
    ("content", "fragment"),
    [
        (b"", r"time: is missing"),
        (b"title = ", r"is not valid TOML: "),
        (b"a = 1\na = 2\n", r"is not valid TOML"),
        (b"\xff\xfe\x00", r"not a text file in UTF-8"),
        (b"time = 3\nbody = 4\nmaterial = 5\n", r"time = 3: must be a table"),
    ],
)
def test_a_file_that_is_no_case_is_refused(tmp_path: Path, content: bytes, fragment: str) -> None:
    (tmp_path / "odd.toml").write_bytes(content)
    with pytest.raises(CaseError, match=fragment):
        load_case(tmp_path / "odd.toml")


def test_all_faults_are_listed_at_once(file: Path) -> None:
    with pytest.raises(CaseError) as caught:
        load_case(file, ["time.end=0", "material.steel.rho=0", "contact.pair.slave=3"])
    assert [m.split(": ")[1].split(" = ")[0] for m in caught.value.messages] == [
        "time.end",
        "material.steel.rho",
        "contact.pair.slave",
    ]
    with pytest.raises(CaseError) as caught:
        load_case(file, ["body.disc.material=a", "body.block.material=b"])
    assert len(caught.value.messages) == 2


def test_a_faulty_entry_is_reported_once(file: Path) -> None:
    with pytest.raises(CaseError) as caught:
        load_case(file, ["body.block.geometry.polygon.points=[[0,0],[1,0],[1]]"])
    assert len(caught.value.messages) == 1  # and not also "needs at least 3 entries"


def test_a_case_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        CaseError, match=r"no such file, folder or bundled case.*ring_impact, ring_impact/polar"
    ):
        load_case(tmp_path / "none.toml")
    with pytest.raises(CaseError, match="did you mean 'ring_impact'"):
        load_case("ring_impct")
    with pytest.raises(CaseError, match=r"holds no case\.toml"):
        load_case(tmp_path)


@pytest.mark.parametrize(
    ("override", "value"),
    [
        ("time.end=5e-3", 5e-3),
        ("time.step=1e-7", 1e-7),
        ("body.disc.initial_velocity=[0, -100]", (0.0, -100.0)),
        ("body.disc.initial_velocity.1=-100", (0.0, -100.0)),
        ("body.block.geometry.polygon.points.1.0=2", ((0.0, 0.0), (2.0, 0.0), (1.0, 1.0))),
        ("title=A new title", "A new title"),
        ('title="3"', "3"),
        ("output.fields.count=7", 7),
        ("grid.shared.cell=0.25", 0.25),
        ("boundary.base.velocity.y=2*t", "2*t"),
        ("hourglass = 0.05", 0.05),
        ("hourglass.viscosity=0.05", 0.05),
        ("integration.uncut='full'", "full"),
        ("integration.cut=1", 1),
        ("damping.bulk_viscosity.linear=0.06", 0.06),
        ("mass_scaling.step=1e-6", 1e-6),
    ],
)
def test_an_override_reaches_any_key(file: Path, override: str, value: object) -> None:
    changed: Any = load_case(file, [override])
    for key in override.split("=")[0].strip().split("."):
        if isinstance(changed, tuple):
            break
        changed = changed[key] if isinstance(changed, dict) else getattr(changed, key)
    assert changed == value


def test_overrides_apply_in_order_and_can_add_a_table(file: Path) -> None:
    added = "material.soft={E=1e9,nu=0.2,rho=1000}"
    case = load_case(
        file, ["time.end=1", added, "material.soft.nu=0.1", "body.disc.material=soft", "time.end=2"]
    )
    assert (case.time.end, case.material["soft"].nu, case.body["disc"].material) == (2.0, 0.1, "soft")


@pytest.mark.parametrize(
    ("grid", "kind"),
    [
        ("{kind='polar', centre=[0,0], radii=[0.5,1.1], counts=[4,40]}", PolarGrid),
        (
            "{kind='mapped', counts=[4,4], bottom={polyline={points=[[0,0],[1,0]]}}, "
            "right={polyline={points=[[1,0],[1,1]]}}, top={function='1+0*x', x=[0,1]}, "
            "left={polyline={points=[[0,0],[0,1]]}}}",
            MappedGrid,
        ),
        ("{file='quads.msh', unit='mm'}", FileGrid),
    ],
)
def test_the_resolved_case_loads_back_equal_from_anywhere(
    file: Path, tmp_path: Path, grid: str, kind: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    (file.parent / "quads.msh").write_text("only looked for, not read, when a case is loaded")
    monkeypatch.chdir(file.parent.parent)
    case = load_case("pair", [f"body.disc.grid={grid}", "time.step=1e-7", "gravity=[0,-9.81]"])
    assert isinstance(case.grid_of("disc"), kind)
    elsewhere = tmp_path / "results" / "case.toml"
    elsewhere.parent.mkdir()
    elsewhere.write_text(resolved_toml(case))
    monkeypatch.chdir(elsewhere.parent)
    assert load_case(elsewhere) == case
    assert resolved_toml(load_case(elsewhere)) == elsewhere.read_text()


def test_the_resolved_case_spells_out_defaults_and_keeps_vectors_on_a_line(file: Path) -> None:
    text = resolved_toml(load_case(file, ["gravity=[0, -9.81]", "body.disc.initial_velocity=[-1e-7, 1e300]"]))
    assert "gravity = [0.0, -9.81]" in text and "initial_velocity = [-1e-07, 1e+300]" in text
    table = tomllib.loads(text)
    assert table["relocation"]["distance"] == 0.1 and table["contact"]["pair"]["overlap"] == "refuse"


def test_a_python_table_is_a_case(tmp_path: Path) -> None:
    table = tomllib.loads(TEXT)
    case = case_from_table(table, tmp_path, "mine")
    assert (
        case.name == "mine"
        and case.path("a.dxf") == tmp_path / "a.dxf"
        and case.path("/b.dxf") == Path("/b.dxf")
    )
    assert table == tomllib.loads(TEXT)  # left as it was


@pytest.mark.parametrize(
    ("path", "name"), [("my disc/case.toml", "my_disc"), ("42/case.toml", "case_42"), ("a/fast.toml", "fast")]
)
def test_a_case_is_named_after_its_folder_or_file(tmp_path: Path, path: str, name: str) -> None:
    (tmp_path / path).parent.mkdir()
    (tmp_path / path).write_text(TEXT)
    assert load_case(tmp_path / path).name == name


def test_bundled_cases_are_sound_and_found_by_name() -> None:
    names = list(bundled_cases())
    assert names.index("ring_impact/polar") == names.index("ring_impact") + 1
    for name in bundled_cases():
        case = load_case(name)
        assert case.title and case.name == name.replace("/", "-")


def test_the_ring_impact_is_the_papers() -> None:
    cartesian, polar = load_case("ring_impact"), load_case("ring_impact/polar")
    for case in (cartesian, polar):
        assert case.body["ring"].initial_velocity == (0.0, -50.0)
        penalty, soft = case.contact["ring_on_obstacle"].penalty, case.material["soft"]
        assert not isinstance(penalty, str) and penalty.times_E is not None
        assert penalty.times_E * soft.E == 1e12  # "100E" of the paper, in Pa/m
        assert (soft.E, soft.nu, soft.rho, case.material["stiff"].E) == (10e9, 0.3, 7800.0, 1000e9)
    grid = polar.grid_of("ring")
    assert isinstance(grid, PolarGrid)
    lines = [
        grid.radii[0] + k * (grid.radii[1] - grid.radii[0]) / grid.counts[0]
        for k in range(grid.counts[0] + 1)
    ]
    assert min(abs(r - 0.4) for r in lines) > 0.1 * (lines[1] - lines[0])  # the outer circle cuts cells
    assert cartesian.model_copy(update={"body": {}, "name": "", "title": ""}) == polar.model_copy(
        update={"body": {}, "name": "", "title": ""}
    )


def test_the_wavy_block_is_the_papers() -> None:
    """Section 4.3: geometry, material, penalty of 100 E, a drag of 1 m in 0.2 s, its finest mesh and its step."""
    case = load_case("wavy_block")
    box, material = case.body["block"].geometry.rectangle, case.material["soft"]
    assert box is not None and (box.low, box.high) == ((0.0, 0.0), (2.0, 1.0))
    assert case.interface["wave"].geometry.function == "0.5 + 0.05*sin(5*pi*x/2)"
    assert (material.E, material.nu, material.rho) == (10e9, 0.3, 7800.0)
    penalty, grid = case.contact["sliding"].penalty, case.grid_of("block")
    assert not isinstance(penalty, str) and penalty.times_E == 100.0
    assert isinstance(grid, CartesianGrid) and grid.counts == (100, 50)
    assert (case.time.end, case.time.step) == (0.2, 1e-6)


def test_the_json_schema_describes_every_key_and_has_no_dangling_reference() -> None:
    schema = json_schema()
    text = json.dumps(schema)
    assert set(schema["properties"]) == set(Case.model_fields)
    for name in re.findall(r'"#/\$defs/(\w+)"', text):
        assert name in schema["$defs"]
    tables = [schema, *schema["$defs"].values()]
    for table in tables:
        assert table["additionalProperties"] is False
        for key, entry in table["properties"].items():
            assert "description" in entry or entry.get("const"), f"{table['title']}.{key} says nothing"


def test_the_json_schema_accepts_the_bundled_cases_and_refuses_unknown_keys() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    validator = jsonschema.Draft202012Validator(json_schema())
    validator.check_schema(json_schema())
    for file in bundled_cases().values():
        validator.validate(tomllib.loads(file.read_text()))
    assert list(validator.iter_errors({**tomllib.loads(TEXT), "tim": 3}))


def test_classic_xfem_refuses_what_it_does_not_do(file: Path) -> None:
    keys = [
        "method='xfem'",
        "contact={}",
        "damping.mass=3",
        "integration.uncut='full'",
        "hourglass.viscosity=0.1",
    ]
    with pytest.raises(CaseError, match=r"without integration\.uncut.*damping\.mass, hourglass\.viscosity"):
        load_case(file, keys)
    assert load_case(file, keys[:2]).method == "xfem"


def test_a_decimal_comma_is_told(tmp_path: Path) -> None:
    (tmp_path / "case.toml").write_text("time = { end = 1 }\n[contact.c]\nfriction = 0,2  # Coulomb\n")
    with pytest.raises(CaseError, match="not valid TOML: .*line 3.*decimal point: 0.2, not 0,2"):
        load_case(tmp_path)
