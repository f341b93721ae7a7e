"""What a line keeps of its bends, against formulas and a minimum that is searched for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from labpipe.law.sliders import SliderLaw, slide_vector, virgin_rests
from labpipe.protocol.load import load_harness
from labpipe.records.arrays import Floats
from labpipe.rod.path import RodPath
from labpipe.rod.statics import follow
from labpipe.studies.harness_line import laid
from labpipe.studies.harness_memory import (
    kept_at_most,
    kept_curvature,
    let_go,
    unbent,
    unloading_reason,
)
from labpipe.studies.harness_section import material_of
from tests.builders.harness_files import EXAMPLES

ONE = SliderLaw(2.0, np.array([6.0]), np.array([1.0]), 0.0, 10.0)
"""A spring of 2 and a slider of 6 that slides at 1."""
SOME = SliderLaw(0.5, np.array([9.0, 3.0, 1.0]), np.array([0.5, 2.0, 5.0]), 0.0, 20.0)


def bent(law: SliderLaw, way: list[tuple[float, float]]) -> Floats:
    """Where the sliders of one station rest after some curvatures."""
    rests = virgin_rests(law, 1, is_vector=True)
    for curvature in way:
        rests = slide_vector(law, np.array([curvature]), rests).rests
    return rests


@pytest.mark.parametrize(
    ("to", "kept"),
    [
        (0.9, 0.0),  # nothing slid
        (1.5, 1.5 - (2.0 * 1.5 + 6.0) / 8.0),  # 0.375: back without sliding
        (2.5, 2.5 - (2.0 * 2.5 + 6.0) / 8.0),  # 1.125: back by 1.375
        (5.0, 3.0),  # back by 2, then it slides the other way until 2 k = 6
    ],
)
def test_one_slider(to: float, kept: float) -> None:
    found = let_go(ONE, bent(ONE, [(to, 0.0)]))
    assert found[0] == pytest.approx([kept, 0.0], abs=1e-8)


def test_a_way_that_turned_ends_where_the_energy_is_least() -> None:
    rests = bent(SOME, [(3.0, 0.0), (4.0, 4.0), (-1.0, 6.0)])

    def energy(curvature: Floats) -> float:
        size = np.linalg.norm(curvature - rests[0], axis=1)
        slips = SOME.slip_curvatures
        held = np.where(size < slips, 0.5 * size**2, slips * size - 0.5 * slips**2)
        return 0.5 * SOME.stiffness * float(curvature @ curvature) + float(SOME.stiffnesses @ held)

    least = minimize(
        energy, np.zeros(2), method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-14}
    )
    assert let_go(SOME, rests)[0] == pytest.approx(least.x, abs=1e-5)


def test_without_a_spring_it_is_found_too() -> None:
    """A slider of 6 that slides at 1 alone: back by 1."""
    law = replace(ONE, stiffness=0.0)
    assert let_go(law, bent(law, [(3.0, 0.0)]))[0] == pytest.approx([2.0, 0.0], abs=1e-8)


def test_many_stations_of_a_real_law_are_let_go() -> None:
    file = EXAMPLES / "harness-slack.yaml"
    law = material_of(load_harness(file), file).sections[0]({}).law
    rng = np.random.default_rng(5)
    rests, now = virgin_rests(law, 300, is_vector=True), np.zeros((300, 2))
    for _ in range(6):
        now = now + rng.normal(scale=10.0, size=now.shape)
        rests = slide_vector(law, now, rests).rests
    found = let_go(law, rests)
    left = slide_vector(law, found, rests).moment
    assert np.abs(left).max() < 1e-8 * law.stiffnesses @ law.slip_curvatures


def test_a_law_without_sliders_keeps_nothing() -> None:
    spring = SliderLaw(1.0, np.zeros(0), np.zeros(0), 0.0, 1.0)
    assert not let_go(spring, np.zeros((4, 0, 2))).any()


@pytest.fixture(scope="module")
def example() -> tuple[RodPath, SliderLaw, float]:
    """The line of the example of slack, which is bent more sharply on the way than when laid."""
    file = EXAMPLES / "harness-slack.yaml"
    harness = load_harness(file)
    material = material_of(harness, file)
    ready = laid(harness, material.sections[0]({}), {})
    path = follow(ready.line, ready.boundaries, steps=harness.steps)
    reason = unloading_reason(path, ready.line)
    assert reason is not None
    assert "85 mm from the start it keeps 1.49 1/m by the rule" in reason.message
    return path, ready.line.section.law, float(ready.line.stations[-1])


def test_a_laid_line_keeps_what_its_own_law_says(
    example: tuple[RodPath, SliderLaw, float],
) -> None:
    """A tenth of its bend by the rule, nearly all of it if nothing slid back."""
    path, law, _ = example
    kept, most = kept_curvature(path.last, law), kept_at_most(path, law)
    bends = np.array([state.bendings for state in path.states])
    node = int(np.argmax(most))
    assert kept[node] == pytest.approx(1.49, abs=0.01)
    assert kept[node] < most[node] < bends[:, node].max()
    # by hand: from the sharpest bend, back by the moment there over the first stiffness
    sharp = path.states[int(np.argmax(bends[:, node]))]
    curvature = sharp.curvatures[node, 0, :2]
    moment = law.stiffness * curvature + law.stiffnesses @ (curvature - sharp.rests[node, 0])
    back = np.linalg.norm(curvature - moment / law.first_stiffness)
    assert most[node] == pytest.approx(float(back), rel=1e-9)


def test_how_far_it_was_unbent(example: tuple[RodPath, SliderLaw, float]) -> None:
    path, _, _ = example
    bends = np.array([state.bendings for state in path.states])
    assert unbent(path) == pytest.approx((bends.max(axis=0) - bends[-1]).max() / bends.max())
    assert 0.7 < unbent(path) < 0.8
    assert unbent(replace(path, states=41 * path.states[-1:])) == 0.0
