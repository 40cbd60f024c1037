"""The wave that meets an interface (paper, section 2.2), its profiles and its variants."""

from __future__ import annotations

import numpy as np
import pytest

from phantomnode.pipeline.case import case_from_table, load_case, resolved_toml, variants
from phantomnode.pipeline.cli import report
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.prepare import prepare
from phantomnode.pipeline.profile import _along, read_profile, stations
from phantomnode.pipeline.report import report_runs
from phantomnode.pipeline.run import run_all

PLATEAU, SPEED, RAMP = 2.487569e7, 2090.394, 1e-7
"""rho c V0, c of dilatational waves, and the rise time of the load, half of which the front starts late."""
LEAKING, TIGHT = ("lumped", "lumped_shifted"), ("consistent", "block_diagonal")


def wave(profile, time):
    """Front at half the plateau, m, where it belongs, plateau over its value, largest stress below the interface."""
    y, stress = profile
    upper = y > 0.005
    k = int(np.argmax(upper & (stress > 0.5 * PLATEAU)))
    front = np.interp(0.5 * PLATEAU, stress[k - 1 : k + 1], y[k - 1 : k + 1])
    path = SPEED * (time - 0.5 * RAMP)
    exact = 0.01 - path if path < 0.005 else path
    behind = stress[y > exact + 0.0005].mean()
    return front, exact, behind / PLATEAU, np.abs(stress[y < 0.0049]).max() / PLATEAU


def waves(folder):
    """The same for every time of the profile of a run."""
    y, columns = read_profile(folder / "profile.height.csv")
    return [wave((y, stress), float(name.split()[2])) for name, stress in columns.items()]


@pytest.fixture(scope="module")
def coarse(tmp_path_factory):
    """All variants on 61 rows of cells."""
    folder = tmp_path_factory.mktemp("wave") / "results"
    few = ["body.block.grid.counts=[4, 61]", "output.fields.count=2", "output.history.count=20"]
    summaries = run_all(load_case("split_block_wave", few), folder)
    assert [summary.status for summary in summaries] == ["done"] * 5
    return folder


def test_phantom_nodes_keep_the_far_side_at_rest(coarse) -> None:
    """To the bit; front and plateau as the 61 rows allow: the front is two cells wide."""
    found = waves(coarse)
    assert len(found) == 3
    for front, exact, plateau, leak in found:
        assert leak == 0.0
        assert front == pytest.approx(exact, rel=0.03)
        assert plateau == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("name", TIGHT)
def test_consistent_and_block_diagonal_mass_do_not_leak(coarse, name: str) -> None:
    assert all(leak < 1e-12 for *_, leak in waves(coarse / "variants" / name))


@pytest.mark.parametrize("name", LEAKING)
def test_lumped_mass_leaks(coarse, name: str) -> None:
    """Once the wave has met the interface, several per cent of it travel on below."""
    before, *after = [leak for *_, leak in waves(coarse / "variants" / name)]
    assert before < 1e-4
    assert all(0.03 < leak < 0.3 for leak in after)


def test_one_picture_shows_all(coarse) -> None:
    assert (coarse / "profile.height.png").stat().st_size > 20_000


def test_report_draws_runs_again(coarse, tmp_path, capsys) -> None:
    pictures = report_runs([coarse], tmp_path / "out")
    assert pictures == [tmp_path / "out" / "profile.height.png"] and pictures[0].is_file()
    assert report((tmp_path,)) == 2
    assert "holds no results of a run" in capsys.readouterr().err


@pytest.mark.slow
def test_the_case_as_it_is_keeps_fronts_and_plateau_within_1_percent(tmp_path) -> None:
    """Closed form: fronts at 5.924, 6.167 and 8.257 mm; the times are the nearest steps."""
    run_all(load_case("split_block_wave"), tmp_path / "results")
    for name in (".", *(f"variants/{tight}" for tight in TIGHT)):
        for front, exact, plateau, leak in waves(tmp_path / "results" / name):
            assert leak < 1e-12 and (leak == 0.0 or name != ".")
            assert front == pytest.approx(exact, rel=0.01)
            assert plateau == pytest.approx(1.0, abs=0.01)
    for name in LEAKING:
        assert waves(tmp_path / "results" / "variants" / name)[2][3] > 0.02


def square_case(**keys):
    return {
        "time": {"end": 1e-5},
        "material": {"m": {"E": 1e9, "nu": 0.3, "rho": 1000.0}},
        "body": {
            "block": {
                "geometry": {"rectangle": {"low": [0.0, 0.0], "high": [1.0, 1.0]}},
                "grid": {"kind": "cartesian", "counts": [4, 4], "aligned": True},
                "material": "m",
            }
        },
        **keys,
    }


def profile(**keys):
    table = {"line": [[0.1, 0.0], [0.1, 1.0]], "quantity": "stress_yy", "times": [1e-6]} | keys
    return {"output": {"profile": {"p": table}}}


def test_stations_along_a_line() -> None:
    """Squares met through the middle, along their common edge (one of the two counts), and slanted."""
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    corners = np.array([square, square + [1.0, 0.0], square + [0.0, 1.0], square + [1.0, 1.0]])
    middle = _along(np.array([[0.25, -1.0], [0.25, 3.0]]), corners)
    assert middle.cell.tolist() == [0, 2] and np.allclose(middle.distance, [1.5, 2.5])
    edge = _along(np.array([[1.0, 3.0], [1.0, -1.0]]), corners)
    assert edge.cell.tolist() == [2, 0] and np.allclose(edge.point, [[1.0, 1.5], [1.0, 0.5]])
    slanted = _along(np.array([[0.0, 0.0], [2.0, 2.0]]), corners)
    assert slanted.cell.tolist() == [0, 3]
    assert np.allclose(slanted.distance, np.sqrt(2.0) * np.array([0.5, 1.5]))
    starts_inside = _along(np.array([[0.5, 0.5], [0.5, 0.75]]), corners)
    assert starts_inside.cell.tolist() == [0] and np.allclose(starts_inside.distance, 0.125)
    assert len(_along(np.array([[3.0, 0.0], [3.0, 1.0]]), corners).cell) == 0


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (profile(line=[[0.1, 0.0], [0.1, 0.0]]), "line has no length"),
        (profile(times=[2e-6, 1e-6]), "must increase"),
        (profile(times=[2.0]), "output.profile.p.times: 2 s lies beyond the end of the run"),
        (profile(quantity="strain"), "output.profile.p.quantity"),
        ({"method": "fem"}, "method"),
        ({"method": "xfem", "xfem": {"mass": "heavy"}}, "xfem.mass"),
        ({"variant": {"a": {"methd": "xfem"}}}, "variant.a: methd"),
        ({"variant": {"a": {"variant": {}}}}, "variant.a: variant"),
        (
            {
                "method": "xfem",
                "contact": {"c": {"slave": "block.top", "master": "block.bottom"}},
            },
            'method = "xfem": classic X-FEM runs without contact',
        ),
    ],
)
def test_bad_values_name_their_key(keys, message: str) -> None:
    with pytest.raises(CaseError) as error:
        case_from_table(square_case(**keys))
    assert message in "\n".join(error.value.messages)


def test_a_profile_that_meets_no_body() -> None:
    prepared = prepare(case_from_table(square_case(**profile(line=[[2.0, 0.0], [2.0, 1.0]]))))
    with pytest.raises(CaseError, match=r"output\.profile\.p\.line: meets no body"):
        stations(prepared)


def test_variants_change_only_their_keys(tmp_path) -> None:
    changes = {"a": {"time": {"safety": 0.5}, "xfem": {"mass": "lumped"}}}
    case = case_from_table(square_case(title="Block", xfem={"enrichment": "shifted"}, variant=changes))
    variant = variants(case)["a"]
    assert (variant.time.safety, variant.time.end) == (0.5, 1e-5)
    assert (variant.xfem.mass, variant.xfem.enrichment) == ("lumped", "shifted")
    assert variant.title == "Block: a" and variant.variant == {} and variant.folder == case.folder
    (tmp_path / "case.toml").write_text(resolved_toml(case))
    assert load_case(tmp_path) == case.model_copy(update={"name": load_case(tmp_path).name})
