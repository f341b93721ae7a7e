from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import stdtrit

from labpipe.mechanics.law.sliders import SliderLaw
from labpipe.mechanics.rod.bands import (
    InputDistribution,
    build_calibration_distributions,
    build_t_distribution,
    join_distributions,
    predict_line_bands,
)
from labpipe.mechanics.rod.boundaries import Gravity, Held, Load
from labpipe.mechanics.rod.line import Line, Section
from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.rod.statics import follow
from labpipe.mechanics.studies.harness_line import LOG_MOMENT_FACTOR
from labpipe.mechanics.wire.calibration.calibrate_wire import Settings, calibrate
from labpipe.mechanics.wire.calibration.variances import compute_quantiles
from labpipe.records.result import Status
from labpipe.records.wire import Calibration
from tests.builders.loading_tests import measured, wire_of
from tests.builders.rods import straight_line

LENGTH, NODES, STEPS = 0.2, 10, 6

LAW = SliderLaw(2e-4, np.array([3e-4, 2e-4]), np.array([1.0, 4.0]), 0.0, 50.0)

BELIEF = join_distributions(
    [
        build_t_distribution("law_factor", 0.08, n_draws=2048),
        build_t_distribution("length_factor", 0.01, n_draws=2048),
        build_t_distribution("free_curvature", 0.3, n_draws=2048, seed=4),
    ]
)


def pushed(inputs: Mapping[str, float]) -> RodPath:
    """A cantilever under its weight, loaded at its end and unloaded again."""
    factor = float(np.exp(inputs.get("law_factor", 0.0)))
    spring, sliders = factor * LAW.spring_stiffness, factor * LAW.slider_stiffnesses
    law = replace(LAW, spring_stiffness=spring, slider_stiffnesses=sliders)
    section = Section(law, 3e-4, mass_per_length=0.006)
    length = LENGTH * float(np.exp(inputs.get("length_factor", 0.0)))
    line = straight_line(length, NODES, section)
    rest_curvature = np.tile([0.0, inputs.get("free_curvature", 0.0), 0.0], (NODES - 1, 1))
    line = Line(line.lengths, section, line.positions, line.frames, rest_curvature)
    share = np.interp(np.arange(STEPS + 1), [0, 4, STEPS], [0.0, 1.0, 0.0])
    load = Load(-1, share[:, None] * np.array([0.0, 0.0, -0.025]))
    return follow(line, (Held(0, np.zeros(3), line.frames[0]), load, Gravity()), steps=STEPS)


@pytest.mark.slow
def test_bands_hold_as_many_draws_as_they_say() -> None:
    bands = predict_line_bands([pushed], [BELIEF], steps=(4, -1))
    assert bands is not None
    assert not bands.notes
    held, free = bands.states
    paths = [pushed(BELIEF.to_inputs(amounts)) for amounts in BELIEF.amounts[:40]]
    tips = np.array([path.states[4].positions[-1, 2] for path in paths])
    covered = (tips > held.positions.lower[-1, 2]) & (tips < held.positions.upper[-1, 2])
    assert covered.mean() >= 0.85
    peaks = np.array(
        [np.linalg.norm(path.states[4].curvature_vectors, axis=-1).max() for path in paths]
    )
    radius = held.smallest_bend_radius
    assert np.mean((1.0 / peaks > radius.lower) & (1.0 / peaks < radius.upper)) >= 0.85
    assert radius.value == pytest.approx(1.0 / held.curvature.value.max())
    heights = np.array([path.last.positions[-1, 2] for path in paths])
    width = free.positions.upper[-1, 2] - free.positions.lower[-1, 2]
    assert width == pytest.approx(np.ptp(np.quantile(heights, [0.025, 0.975])), rel=0.3)


def test_several_solutions_are_joined_each_with_its_own_solver() -> None:
    def stiffer(inputs: Mapping[str, float]) -> RodPath:
        return pushed({**inputs, "law_factor": inputs["law_factor"] + 0.5})

    tips = []
    for solvers in ([pushed], [stiffer], [pushed, stiffer]):
        bands = predict_line_bands(solvers, [BELIEF] * len(solvers), steps=(4,))
        assert bands is not None
        shares = bands.states[0].variance_fractions["positions"]
        assert set(shares) == {"law_factor", "length_factor", "free_curvature"}
        assert sum(shares.values()) == pytest.approx(1.0)
        band = bands.states[0].positions
        tips.append((band.lower[-1, 2], band.value[-1, 2], band.upper[-1, 2]))
    first, second, joined = tips
    assert joined == (min(first[0], second[0]), first[1], max(first[2], second[2]))


def test_sides_without_equilibrium_and_jumps_at_other_steps_are_noted() -> None:
    def torn(drawn: Mapping[str, float]) -> RodPath:
        return replace(pushed(drawn), status=Status("failed" if drawn["law_factor"] > 0 else "ok"))

    def jumping(inputs: Mapping[str, float]) -> RodPath:
        return replace(pushed(inputs), jump_steps=(0,) if inputs["law_factor"] < 0.0 else (0, 3))

    distribution = build_t_distribution("law_factor", 0.05)
    for solve, code, facts in ((torn, "one_sided", "law_factor"), (jumping, "jumps", "3 at the")):
        bands = predict_line_bands([pushed, solve], [distribution, distribution])
        assert bands is not None
        assert [note.code for note in bands.notes] == [code]
        assert facts in bands.notes[0].message
    assert predict_line_bands([torn], [replace(distribution, centre=np.array([0.2]))]) is None
    with pytest.raises(ValueError, match="at least one"):
        predict_line_bands([], [])


def test_a_line_beyond_what_was_tested_is_doubtful() -> None:
    distribution = build_t_distribution("law_factor", 0.05)
    bands = predict_line_bands([pushed], [distribution], tested_curvature=2.0)
    assert bands is not None
    assert [note.code for note in bands.notes] == ["beyond_tested"]
    assert bands.notes[0].where == "step 4, node 0"


MANY = 32_768


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    outcome = calibrate(wire_of("A3"), measured("A3", (0.12,), seed=1), Settings(gain=0.005))
    assert isinstance(outcome, Calibration)
    return outcome


def drawn(belief: InputDistribution, direction: dict[str, float]) -> np.ndarray:
    weights = np.array([direction.get(name, 0.0) for name in belief.names])
    return np.asarray(belief.amounts @ belief.steps.T @ weights)


def test_there_is_one_for_each_solution_of_the_set(calibration: Calibration) -> None:
    beliefs = build_calibration_distributions(
        calibration.solutions, calibration.widening, specimen=LOG_MOMENT_FACTOR
    )
    assert len(beliefs) == 2
    for belief, solution in zip(beliefs, calibration.solutions, strict=True):
        assert belief.to_inputs()["copper_scale"] == pytest.approx(np.log(solution.values[2]))
        assert belief.to_inputs()[LOG_MOMENT_FACTOR] == 0.0
    unlikely = replace(calibration.solutions[1], rise=2.0 * calibration.solutions[1].limit)
    assert len(build_calibration_distributions([calibration.solutions[0], unlikely])) == 1


@pytest.mark.parametrize("one_more", [0.0, 1.0])
def test_draws_have_the_quantiles_of_the_mixture(calibration: Calibration, one_more: float) -> None:
    solution = replace(calibration.solutions[0], rise=0.0)
    [belief] = build_calibration_distributions([solution], specimen=LOG_MOMENT_FACTOR, n_draws=MANY)
    for weights in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.2, 0.5, 0.3)):
        direction = dict(zip(belief.names, weights, strict=False)) | {LOG_MOMENT_FACTOR: one_more}
        ends = np.quantile(drawn(belief, direction), [0.025, 0.975])
        directions = np.array([[*weights, 0.0]])
        expected = np.ravel(compute_quantiles(solution.mixture, directions, np.array([one_more])))
        assert ends == pytest.approx(expected, rel=0.02)


def test_a_less_likely_solution_is_narrower(calibration: Calibration) -> None:
    solution = calibration.solutions[0]
    half = replace(solution, rise=0.75 * solution.limit)
    likely, unlikely = build_calibration_distributions([replace(solution, rise=0.0), half])
    ratio = np.std(unlikely.amounts @ unlikely.steps.T, axis=0) / np.std(
        likely.amounts @ likely.steps.T, axis=0
    )
    assert ratio == pytest.approx([0.5, 0.5, 0.5], rel=0.2)
    assert LOG_MOMENT_FACTOR not in likely.names


def test_a_stated_deviation_is_drawn_from_students_t() -> None:
    for freedom, quantile in ((np.inf, 1.96), (4.0, float(stdtrit(4.0, 0.975)))):
        belief = build_t_distribution("mass_factor", 0.02, freedom=freedom, n_draws=MANY)
        assert belief.to_inputs(np.ones(1)) == {"mass_factor": 0.02}
        upper = np.quantile(drawn(belief, {"mass_factor": 1.0}), 0.975)
        assert upper == pytest.approx(0.02 * quantile, rel=1e-3)
    with pytest.raises(ValueError, match=r"length_factor: deviation=0\.0"):
        build_t_distribution("length_factor", 0.0)


def test_causes_of_one_input_add() -> None:
    joined = join_distributions(
        [
            build_t_distribution("law_factor", 0.03, cause="specimen"),
            build_t_distribution("law_factor", 0.04, cause="spool"),
        ]
    )
    assert joined.names == ("law_factor",)
    assert joined.causes == ("specimen", "spool")
    assert np.std(drawn(joined, {"law_factor": 1.0})) == pytest.approx(0.05, rel=0.05)
    specimen, spool = joined.amounts.T
    assert abs(float(np.mean(specimen * spool))) < 0.05
