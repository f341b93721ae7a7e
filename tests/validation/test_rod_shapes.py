"""The rod against closed forms and boundary value problems that share no code with it.

Errors fall with the square of the elements' length; the page `docs/explanations/rod.md` shows them
to 80 elements. What a rod does with sliders is judged in `tests/rod`.
"""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.law.sliders import SliderLaw
from tests.judges.judged_rods import (
    arch_path,
    bend_error,
    buckled_column_error,
    catenary_error,
    heavy_cantilever_error,
    posed_rod_error,
    pressed_column_path,
)
from tests.judges.rod_references import pressed_column


def quarter(error: float) -> object:
    """What is left of an error of second order when elements are half as long."""
    return pytest.approx(0.25 * error, rel=0.25)


def size(error: object) -> float:
    return float(np.linalg.norm(np.asarray(error)))


@pytest.mark.parametrize(
    ("weight", "bound"), [(0.1, 1e-6), (1.0, 2e-5), (10.0, 4e-4), (50.0, 1e-3)]
)
def test_cantilever_under_its_weight(weight: float, bound: float) -> None:
    """PHYSICS 7: w L^3 / EI from 0.1 to 50."""
    coarse, fine = (size(heavy_cantilever_error(elements, weight)) for elements in (20, 40))
    assert coarse < bound
    assert fine < 0.32 * coarse


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [20.0, 60.0, 120.0, 176.0])
def test_column_after_buckling(degrees: float) -> None:
    """Found from the straight column, which stands on its own up to the critical load."""
    error = buckled_column_error(40, degrees)
    assert size(error) < 1e-3
    assert size(buckled_column_error(80, degrees)) < 0.3 * size(error)


@pytest.mark.parametrize("steps", [2, 32])
def test_column_pressed_along_itself(steps: int) -> None:
    """It buckles at the first chance however coarse the steps, and loses nothing."""
    wanted = np.array(pressed_column(0.2))
    errors = []
    for elements in (20, 40):
        path = pressed_column_path(elements, steps)
        assert path.status == "ok"
        force = np.linalg.norm(path.last.reaction_forces[1])
        errors.append(np.abs(np.array([force, path.stored[-1]]) / wanted - 1.0))
        assert abs(path.jumped[-1]) < 1e-4 * path.stored[-1]
        assert path.work[-1] == pytest.approx(path.stored[-1], rel=2e-3)
    assert np.max(errors[1]) < 3e-3
    assert np.max(errors[1]) == quarter(float(np.max(errors[0])))


def test_column_with_sliders_pressed_along_itself() -> None:
    """What it loses, and how hard it pushes, does not hang on the steps."""
    law = SliderLaw(0.3, np.array([0.4, 0.2, 0.1]), np.array([0.25, 1.0, 2.5]), 0.0, 40.0)
    paths = [pressed_column_path(30, steps, law) for steps in (2, 16, 64)]
    lost, force = zip(
        *((path.lost[-1], np.linalg.norm(path.last.reaction_forces[1])) for path in paths),
        strict=True,
    )
    assert all(path.status == "ok" and path.lost_in_jumps[-1] < 0.02 * lost[2] for path in paths)
    assert lost[:2] == pytest.approx(lost[2:] * 2, rel=3e-3)
    assert force[:2] == pytest.approx(force[2:] * 2, rel=3e-3)


@pytest.mark.slow
def test_an_arch_snaps_through_at_its_largest_load() -> None:
    """However small the steps; what is set free is the area above the curve of a held arch."""
    ways = np.linspace(0.0, 0.14, 281)
    held = arch_path(ways=ways)
    assert held.snapped == ()
    force = np.array([state.reaction_forces[2, 2] for state in held.states])
    force *= np.sign(force[-1])
    top = int(np.argmax(force[:140]))
    most = force[top]
    behind = top + int(np.flatnonzero(force[top + 5 :] > most)[0]) + 5
    above = most - force[top : behind + 1]
    area = np.sum(0.5 * (above[1:] + above[:-1])) * ways[1]
    for loads in (
        np.linspace(0.0, 1.2, 97) * most,
        np.concatenate([[0.0, 0.5], np.linspace(0.998, 1.001, 61)]) * most,
        np.concatenate([[0.0, 0.9], np.linspace(0.99999, 1.0001, 61)]) * most,
    ):
        path = arch_path(loads)
        assert path.status == "ok"
        (step,) = path.snapped
        assert loads[step - 1] < 1.0002 * most
        assert loads[step] > 0.9998 * most
        assert path.jumped[-1] == pytest.approx(area, rel=0.01)
        down = path.states[0].positions[8, 2] - path.last.positions[8, 2]
        assert np.interp(down, ways, force) == pytest.approx(loads[-1], rel=0.01)


def test_bend_of_45_degrees() -> None:
    """Bathe and Bolourchi (1979): within 0.02 % of 100 with 16 elements, of second order."""
    coarse, fine = size(bend_error(16)), size(bend_error(32))
    assert coarse < 0.03
    assert fine == quarter(coarse)


def test_catenary() -> None:
    """A rod of next to no stiffness between two pins: its sag, of its length."""
    coarse, fine = catenary_error(20), catenary_error(40)
    assert 0.0 < fine < 1e-4
    assert fine == pytest.approx(0.25 * coarse, rel=0.05)


@pytest.mark.slow
def test_rod_posed_in_space() -> None:
    """Clamped at both ends, twisted and under its weight: shape and the far clamp's force."""
    (coarse, pulls), (fine, pull) = posed_rod_error(20), posed_rod_error(40)
    assert fine < 2e-4
    assert pull < 2e-3
    assert fine == quarter(coarse)
    assert pull == quarter(pulls)
