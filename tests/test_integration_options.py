"""Integration, hourglass, damping and mass scaling from the case file to the results."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from scipy.linalg import eigh

from phantomnode.pipeline.case import case_from_table
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.prepare import prepare
from phantomnode.pipeline.run import check, run
from phantomnode.solver.layout import prepare_layout
from phantomnode.solver.leapfrog import evaluate_forces, initial_state
from phantomnode.solver.stress import cut_stress, element_stress

YOUNG, NU, RHO = 1e10, 0.3, 7800.0
SPEED = np.sqrt(YOUNG * (1 - NU) / ((1 + NU) * (1 - 2 * NU)) / RHO)


def bar_table(cell=0.1, **more):
    """A bar, 1 m long, whose four sides cut the grid."""
    return {
        "time": {"end": 1e-3},
        "material": {"m": {"E": YOUNG, "nu": NU, "rho": RHO}},
        "body": {
            "bar": {
                "geometry": {"rectangle": {"low": [0.0137, 0.021], "high": [1.0137, 0.1713]}},
                "grid": {"kind": "cartesian", "cell": cell, "box": [[0.0, 0.0], [1.2, 0.3]]},
                "material": "m",
            }
        },
        **more,
    }


SIDES = {"sides": {"on": {"body": "bar", "box": [[-1.0, -1.0], [3.0, 3.0]]}, "displacement": {"y": 0.0}}}


def lowest_frequency(prepared):
    """First elastic frequency along x, rad/s, from the nodal forces of the prepared model and its masses."""
    model = prepared.model
    layout = prepare_layout(model)
    state = initial_state(model, np.zeros_like(model.x), layout)
    step, columns = 1e-7, []
    for k in range(len(model.x)):
        side = []
        for sign in (1.0, -1.0):
            state.u[:] = 0.0
            state.u[k, 0] = sign * step
            evaluate_forces(model, layout, state)
            side.append(state.force[:, 0].copy())
        columns.append((side[1] - side[0]) / (2 * step))
    stiffness = np.column_stack(columns)
    values = eigh(0.5 * (stiffness + stiffness.T), np.diag(model.mass), subset_by_index=[0, 1])[0]
    return np.sqrt(values[1])


@pytest.mark.parametrize(
    "option", [{}, {"integration": {"uncut": "full"}}, {"integration": {"uncut": "full", "cut": 1}}]
)
def test_frequency_of_a_cut_bar_converges_with_rate_two(option):
    """Sides held, ends free: pi c_d/L. The cuts lie anywhere: fractions from 0.8 down to 0.005."""
    cells = 1.0371 / np.array([6.0, 12.0, 24.0, 48.0])
    errors = []
    for cell in cells:
        prepared = prepare(case_from_table(bar_table(float(cell), boundary=SIDES, **option)))
        errors.append(abs(lowest_frequency(prepared) / (np.pi * SPEED) - 1.0))
    assert 1.8 < np.polyfit(np.log(cells), np.log(errors), 1)[0] < 2.4
    assert errors[-1] < 5e-4


def test_alpha_stiffens_what_it_is_put_on():
    """With the mass scaled as well, the step stays, but inertia is added: the frequency falls. Not for waves."""
    plain, heavy = (
        prepare(
            case_from_table(
                bar_table(1.0371 / 12, boundary=SIDES, integration={"alpha": alpha, "alpha_below": 0.6})
            )
        )
        for alpha in (1.0, 4.0)
    )
    assert heavy.dt >= plain.dt * (1.0 - 1e-12) and heavy.model.mass.sum() > 1.05 * plain.model.mass.sum()
    assert 0.7 < lowest_frequency(heavy) / lowest_frequency(plain) < 1.0
    assert any("mass is added" in note for note in heavy.warnings)
    assert not any("mass is added" in note for note in plain.warnings)


def stretched(**more):
    """A bar with cut long sides, held at grid lines at both ends and drawn out to 1.5 smoothly, damped."""
    return {
        "time": {"end": 0.12},
        "material": {"m": {"E": YOUNG, "nu": NU, "rho": RHO}},
        "body": {
            "bar": {
                "geometry": {"rectangle": {"low": [0.0, 0.03], "high": [1.0, 0.34]}},
                "grid": {
                    "kind": "cartesian",
                    "counts": [8, 4],
                    "aligned": True,
                    "box": [[0.0, 0.0], [1.0, 0.5]],
                },
                "material": "m",
            }
        },
        "boundary": {
            "left": {"on": "bar.left", "displacement": {"x": 0.0}},
            "right": {"on": "bar.right", "displacement": {"x": "0.5*ramp(t, 0, 0.08)"}},
            "foot": {"on": {"body": "bar", "box": [[-1.0, 0.124], [2.0, 0.126]]}, "displacement": {"y": 0.0}},
        },
        "damping": {"mass": 1500.0},
        **more,
    }


@pytest.mark.parametrize("option", [{}, {"integration": {"uncut": "full", "cut": 1}}])
def test_a_slow_damped_run_reaches_the_closed_form(option, tmp_path):
    """Uniaxial stretch 1.5 with free cut sides, as a run from the case file: 3.534179e9 Pa in every cell."""
    table = stretched(**option, output={"fields": {"count": 1}, "history": {"count": 50}})
    case = case_from_table(table)
    summary = run(case, tmp_path / "out")
    assert summary.status == "done" and summary.figures["energy_error_max"] < 1e-3
    assert summary.figures["energies"]["damping"] > 0.0
    with (tmp_path / "out" / "history.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {"friction", "damping"} <= set(rows[0])
    assert float(rows[-1]["damping"]) == summary.figures["energies"]["damping"]
    assert float(rows[-1]["friction"]) == 0.0
    # The reaction over the current height: stress * 0.31 * 0.8404896.
    force = 3.534179e9 * 0.31 * 0.8404896
    assert float(rows[-1]["reaction.right.fx"]) == pytest.approx(force, rel=1e-6)


def test_mass_scaling_through_the_case_file(tmp_path):
    table = bar_table(0.1, boundary=SIDES)
    plain = prepare(case_from_table(table))
    assert not any("mass is added" in note for note in plain.warnings)
    target = 1.5 * plain.dt
    prepared = check(case_from_table({**table, "mass_scaling": {"step": target}}), tmp_path)
    assert prepared.dt <= prepared.estimate.dt and prepared.estimate.dt == pytest.approx(target, rel=1e-9)
    added = prepared.model.mass.sum() - plain.model.mass.sum()
    assert added > 0.05 * plain.model.mass.sum()
    assert any("mass is added" in text for text in prepared.warnings)
    table["output"] = {"fields": {"count": 1}, "history": {"count": 5}}
    summary = run(case_from_table({**table, "mass_scaling": {"step": target}}), tmp_path / "out")
    assert summary.figures["added_mass"]["bar"] == pytest.approx(added, rel=1e-9)
    np.testing.assert_array_equal(prepared.model.load, plain.model.load)
    few = prepare(case_from_table({**table, "mass_scaling": {"step": 1.0001 * plain.dt}}))
    assert not any("mass is added" in note for note in few.warnings)
    assert few.model.mass.sum() < 1.001 * plain.model.mass.sum()


def test_a_step_that_the_penalty_forbids_is_refused():
    table = bar_table(0.1)
    table["body"]["floor"] = {
        "geometry": {"rectangle": {"low": [0.0, -0.2], "high": [1.2, 0.0]}},
        "grid": {"kind": "cartesian", "cell": 0.1},
        "material": "m",
    }
    table["contact"] = {"rest": {"slave": "bar.outer", "master": "floor.top", "penalty": {"times_E": 1000}}}
    table["mass_scaling"] = {"step": 1e-3}
    with pytest.raises(
        CaseError, match=r"mass_scaling\.step: 0\.001 s cannot be reached: the contact penalties"
    ):
        prepare(case_from_table(table))


def test_quadratic_viscosity_shortens_the_step_by_the_speeds_of_the_case():
    table = bar_table(0.1, damping={"bulk_viscosity": {"quadratic": 1.2}})
    still = prepare(case_from_table(table))
    table["boundary"] = {
        "push": {
            "on": {"body": "bar", "box": [[-1.0, -1.0], [0.01, 1.0]]},
            "velocity": {"x": "100*ramp(t, 0, 1e-4)"},
        }
    }
    pushed = prepare(case_from_table(table))
    assert pushed.estimate.dt < 0.9 * still.estimate.dt and pushed.estimate.xi > 0.05


def test_output_of_every_option_is_the_same_uniform_stress(tmp_path):
    """Fields are taken from the points that there are: one or three a triangle, one or four a cell."""
    from phantomnode.pipeline.clip import ClippedBodies
    from phantomnode.pipeline.fields import cell_fields

    for option in ({}, {"uncut": "full"}, {"cut": 1}, {"uncut": "full", "cut": 1, "alpha": 3.0}):
        prepared = prepare(case_from_table(bar_table(0.1, integration=option)))
        u = prepared.model.x @ np.array([[0.5, 0.0], [0.0, 0.0]])
        state = cell_fields(prepared, ClippedBodies.of(prepared), u)
        np.testing.assert_allclose(state.cauchy[:, 0], 3.638789e9, rtol=1e-6)
        assert len(cut_stress(prepared.model.full, u)[0]) == (
            4 * len(element_stress(prepared.model.elements, u)[0]) if option.get("uncut") else 0
        )
