"""Bands of lines: against draws that are each solved, and what makes them doubtful."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from labpipe.law.sliders import SliderLaw
from labpipe.rod.bands import bands_of, bent
from labpipe.rod.beliefs import Belief, joined, known
from labpipe.rod.boundaries import Gravity, Held, Load
from labpipe.rod.line import Line, Section
from labpipe.rod.path import RodPath
from labpipe.rod.statics import follow
from tests.builders.rods import straight_line

LENGTH, NODES, STEPS = 0.2, 10, 6
LAW = SliderLaw(2e-4, np.array([3e-4, 2e-4]), np.array([1.0, 4.0]), 0.0, 50.0)
BELIEF = joined(
    [
        known("law_factor", 0.08, draws=2048),
        known("length_factor", 0.01, draws=2048),
        known("free_curvature", 0.3, draws=2048, seed=4),
    ]
)


def pushed(inputs: Mapping[str, float]) -> RodPath:
    """A cantilever under its weight, loaded at its end and unloaded again."""
    factor = float(np.exp(inputs.get("law_factor", 0.0)))
    law = replace(LAW, stiffness=factor * LAW.stiffness, stiffnesses=factor * LAW.stiffnesses)
    section = Section(law, 3e-4, mass_per_length=0.006)
    length = LENGTH * float(np.exp(inputs.get("length_factor", 0.0)))
    line = straight_line(length, NODES, section)
    natural = np.tile([0.0, inputs.get("free_curvature", 0.0), 0.0], (NODES - 1, 1))
    line = Line(line.lengths, section, line.positions, line.frames, natural)
    share = np.interp(np.arange(STEPS + 1), [0, 4, STEPS], [0.0, 1.0, 0.0])
    force = share[:, None] * np.array([0.0, 0.0, -0.025])
    held = Held(0, np.zeros(3), line.frames[0])
    return follow(line, (held, Load(-1, force), Gravity()), steps=STEPS)


def solved(belief: Belief, count: int) -> list[RodPath]:
    return [pushed(belief.inputs(amounts)) for amounts in belief.amounts[:count]]


@pytest.mark.slow
def test_bands_hold_as_many_draws_as_they_say() -> None:
    bands = bands_of(pushed, [BELIEF], at=(4, -1))
    assert bands is not None
    assert not bands.notes
    held, free = bands.states
    paths = solved(BELIEF, 40)
    tips = np.array([path.states[4].positions[-1, 2] for path in paths])
    inside = (tips > held.positions.lower[-1, 2]) & (tips < held.positions.upper[-1, 2])
    assert inside.mean() >= 0.85
    most = np.array([np.linalg.norm(bent(path.states[4]), axis=-1).max() for path in paths])
    radius = held.smallest_bend_radius
    assert np.mean((1.0 / most > radius.lower) & (1.0 / most < radius.upper)) >= 0.85
    assert radius.value == pytest.approx(1.0 / held.curvature.value.max())
    back = np.array([path.last.positions[-1, 2] for path in paths])
    width = free.positions.upper[-1, 2] - free.positions.lower[-1, 2]
    assert width == pytest.approx(np.ptp(np.quantile(back, [0.025, 0.975])), rel=0.3)


def test_shares_are_of_the_causes() -> None:
    bands = bands_of(pushed, [BELIEF])
    assert bands is not None
    shares = bands.states[0].shares["positions"]
    assert set(shares) == {"law_factor", "length_factor", "free_curvature"}
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["free_curvature"] > shares["length_factor"]


def test_several_solutions_are_joined_each_with_its_own_solver() -> None:
    def stiffer(inputs: Mapping[str, float]) -> RodPath:
        return pushed({**inputs, "law_factor": inputs["law_factor"] + 0.5})

    one, other, both = (
        bands_of(solve, [BELIEF] * count, at=(4,))
        for solve, count in ((pushed, 1), (stiffer, 1), ([pushed, stiffer], 2))
    )
    assert one is not None
    assert other is not None
    assert both is not None
    ends = [
        (each.states[0].positions.lower[-1, 2], each.states[0].positions.upper[-1, 2])
        for each in (one, other, both)
    ]
    assert ends[2] == (min(ends[0][0], ends[1][0]), max(ends[0][1], ends[1][1]))
    assert both.states[0].positions.value[-1, 2] == one.states[0].positions.value[-1, 2]


def test_a_line_beyond_what_was_tested_is_doubtful() -> None:
    bands = bands_of(pushed, [known("law_factor", 0.05)], tested_curvature=2.0)
    assert bands is not None
    assert [note.code for note in bands.notes] == ["beyond_tested"]
    assert bands.notes[0].where == "step 4, node 0"


def test_sides_without_equilibrium_are_told() -> None:
    def torn(inputs: Mapping[str, float]) -> RodPath:
        path = pushed(inputs)
        return replace(path, status="failed") if inputs["law_factor"] > 0.0 else path

    bands = bands_of(torn, [known("law_factor", 0.05)])
    assert bands is not None
    assert [note.code for note in bands.notes] == ["one_sided"]
    nowhere = bands_of(torn, [known("law_factor", 0.05, centre=0.2)])
    assert nowhere is None


def test_jumps_at_other_steps_are_told() -> None:
    def jumping(inputs: Mapping[str, float]) -> RodPath:
        path = pushed(inputs)
        return replace(path, snapped=(0, 3) if inputs["law_factor"] < 0.0 else (0,))

    bands = bands_of(jumping, [known("law_factor", 0.05)])
    assert bands is not None
    assert [note.code for note in bands.notes] == ["jumps"]


def test_curvature_as_the_line_lies_has_that_at_rest() -> None:
    """A line without weight and load lies as it was at rest."""
    line = straight_line(LENGTH, NODES, Section(LAW, 3e-4))
    natural = np.tile([0.0, 2.5, 0.0], (NODES - 1, 1))
    line = Line(line.lengths, line.section, line.positions, line.frames, natural)
    state = follow(line, (Held(0, np.zeros(3), line.frames[0]),), steps=1).last
    assert np.linalg.norm(bent(state), axis=-1)[1:-1] == pytest.approx(
        np.full((NODES - 1, 2), 2.5), rel=1e-3
    )


def test_bands_want_a_belief() -> None:
    with pytest.raises(ValueError, match="at least one"):
        bands_of(pushed, [])
