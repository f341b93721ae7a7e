from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.mechanics.studies.first_loadings import (
    FirstLoading,
    NotUsableError,
    estimate_force_zero_error,
    estimate_offset_error,
    estimate_scale_errors,
    estimate_zero_error,
    extract_first_loading,
    make_sheet_weight_notes,
    read_first_loadings,
    set_self_weight,
)
from labpipe.protocol.load import load_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.curve import Aligned, Branch, ClockFit, Curve, Direction, Interval, Series
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.result import Contribution, Result, Specimen, Status, TestResult
from labpipe.units import GRAVITY
from tests.approved import Approve

LENGTH, PEAK, COUNT = 0.085, 0.05, 2000


NOISE = 1e-3


def record_of(**changes: object) -> TestResult:
    result = TestResult(
        test="T1",
        specimen=Specimen("A2", "A2-s1", "3", {"length": LENGTH}),
        protocol="wire-cantilever",
        protocol_yaml="",
        test_yaml="",
        labpipe_version="0",
        inputs=(),
        recordings={},
        aligned=None,
        curve=None,
        shape=None,
        results=(Result("peak_force.1", 0.2, "N"),),
        quality=(),
    )
    return replace(result, **changes)  # type: ignore[arg-type]


def result_of(**changes: object) -> TestResult:
    """A test of one cycle: force rises with the root of the deflection."""
    random = np.random.default_rng(1)
    up = np.linspace(-0.1e-3, PEAK, COUNT)
    displacement = np.concatenate([up, up[::-1]])
    force = 0.2 * np.sqrt(np.maximum(displacement, 0.0) / PEAK)
    force = force + NOISE * random.standard_normal(len(force))
    curve = Curve(
        time=np.arange(2 * COUNT) / 100.0,
        displacement=displacement,
        force=force,
        branches=(
            Branch(0, COUNT, 1, Direction.LOADING, 0.0, 20.0),
            Branch(COUNT, 2 * COUNT, 1, Direction.UNLOADING, 20.0, 40.0),
        ),
    )
    return record_of(**{"curve": curve} | changes)


@pytest.fixture(scope="module")
def protocol(repository: Path) -> Protocol:
    return load_protocol(repository / "protocols" / "wire-cantilever.yaml")


def taken(
    protocol: Protocol, result: TestResult | None = None, up_to: float | None = None
) -> FirstLoading:
    return extract_first_loading(result or result_of(), protocol, 200, max_deflection=up_to)


def test_points_are_means_of_the_first_loading_alone(protocol: Protocol) -> None:
    curve = taken(protocol).curve
    assert (curve.wire, curve.test, curve.sample) == ("A2", "T1", "A2-s1, sample 3")
    assert np.all(np.diff(curve.deflection) > 0.0)
    assert curve.deflection[0] > 0.0
    assert 190 <= len(curve.deflection) <= 400
    truth = 0.2 * np.sqrt(curve.deflection / PEAK)
    assert np.std(curve.force[20:] - truth[20:]) < 0.5 * NOISE
    of_mean = NOISE / np.sqrt(COUNT / 200)
    assert 0.7 * of_mean < float(np.min(curve.noise))
    assert float(np.mean(curve.noise)) < 1.6 * of_mean


def test_noise_of_the_deflection_is_in_that_of_the_force(protocol: Protocol) -> None:
    result = result_of()
    assert result.curve is not None
    off = 0.2e-3 * np.random.default_rng(2).standard_normal(len(result.curve.displacement))
    seen = replace(result.curve, displacement=result.curve.displacement + off)
    curve = taken(protocol, replace(result, curve=seen)).curve
    slope = 0.1 / np.sqrt(PEAK * curve.deflection)
    wanted = np.hypot(NOISE, 0.2e-3 * slope) / np.sqrt(COUNT / 200)
    middle = (curve.deflection > 0.01) & (curve.deflection < 0.045)
    assert np.asarray(curve.noise)[middle] == pytest.approx(wanted[middle], rel=0.35)


def test_rig_and_gain_are_those_of_the_protocol(protocol: Protocol) -> None:
    loading = taken(protocol)
    assert loading.gain_uncertainty == pytest.approx(0.002)
    rig = loading.curve.rig
    assert rig is not None
    assert rig.string_length == rig.anchor_height == pytest.approx(0.76)
    assert rig.weight == pytest.approx(2.7e-3 * GRAVITY)
    assert rig.anchor_x == pytest.approx(LENGTH)
    without = protocol.model_copy(update={"rig": protocol.rig.model_copy(update={"string": None})})
    assert taken(without).curve.rig is None


def test_what_is_odd_is_taken_and_told(protocol: Protocol) -> None:
    lost = (Reason("gap", "a marker was lost"),)
    doubtful = Result("peak_force.1", 0.2, "N", status=Status.DOUBTFUL, reasons=lost)
    loading = taken(protocol, result_of(results=(doubtful,)), up_to=0.02)
    assert loading.curve.deflection.max() <= 0.02
    assert [(note.code, note.where) for note in loading.notes] == [
        ("test_doubtful", "T1"),
        ("rest_unknown", "T1"),
        ("loading_cut", "T1"),
    ]
    assert loading.notes[0].message == "used unchanged: gap: a marker was lost"
    assert loading.notes[2].message.endswith("points beyond 20 mm were left out")


def test_tests_that_cannot_be_used(protocol: Protocol, repository: Path, approved: Approve) -> None:
    curve = result_of().curve
    assert curve is not None
    only_back = result_of(curve=replace(curve, branches=curve.branches[1:]))
    why = (Reason("no_cycle", "none"),)
    failed = Result("peak_force.1", None, "N", status=Status.FAILED, reasons=why)
    bare = protocol.specimen.model_copy(update={"length": None})
    no_length = protocol.model_copy(update={"specimen": bare})
    pulled = load_protocol(repository / "protocols" / "corrugated-tube.yaml")
    cases: list[tuple[Protocol, TestResult, float | None]] = [
        (protocol, result_of(curve=None), None),
        (protocol, only_back, None),
        (protocol, result_of(results=(failed,)), None),
        (no_length, result_of(specimen=Specimen("A2", "s", "1")), None),
        (protocol, result_of(), 1e-3),
        (pulled, result_of(), None),
    ]
    messages = []
    for protocol, result, up_to in cases:
        with pytest.raises(NotUsableError) as refused:
            taken(protocol, result, up_to)
        messages.append(str(refused.value))
    approved(messages)


def test_a_wire_that_hung_under_its_counterweight(protocol: Protocol) -> None:
    result = result_of()
    assert result.curve is not None
    travel = result.curve.displacement + 1.5e-3
    aligned = Aligned(result.curve.time, {"travel": Series(travel, "m")})
    with pytest.raises(
        NotUsableError, match=r"slack at rest: .* 1.5 mm before .*shorten the string"
    ):
        taken(protocol, replace(result, aligned=aligned))
    light = protocol.rig.string.model_copy(update={"counterweight": 0.0})  # type: ignore[union-attr]
    rig = protocol.rig.model_copy(update={"string": light})
    assert not taken(
        protocol.model_copy(update={"rig": rig}), replace(result, aligned=aligned)
    ).notes


@pytest.mark.parametrize("code", ["zero_not_at_rest", "begins_under_load"])
def test_a_test_without_a_zero_is_left_out(protocol: Protocol, code: str) -> None:
    message = "zeroed from 0.00 s to 2.00 s of the motion's clock, but the clamp moves from 1.00 s"
    lost = result_of(quality=(QualityNote(code, Severity.WARNING, "force", message),))
    with pytest.raises(NotUsableError, match=rf"its zero is lost.*force: zeroed.*\({code}\)"):
        taken(protocol, lost)
    other = result_of(quality=(QualityNote("gap", Severity.WARNING, "force", "a gap"),))
    assert taken(protocol, other).curve.test == "T1"


def test_files_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    broken = tmp_path / "result.h5"
    broken.write_bytes(b"none")
    names: list[str] = []
    loadings, left_out = read_first_loadings([broken], min_points=200, report_name=names.append)
    assert (loadings, names) == ([], [tmp_path.name])
    assert str(broken) in left_out[str(broken)]


def weighing(grams: float, loading: FirstLoading) -> FirstLoading:
    """A test whose sheet says so many grams per metre; 0 for one that says none."""
    curve = replace(loading.curve, self_weight=1e-3 * grams * GRAVITY)
    return replace(loading, curve=curve)


def test_the_mass_of_the_test_or_of_the_sheet_of_wires(
    protocol: Protocol, approved: Approve
) -> None:
    """The length of the test is used; a third off, or none, is reported."""
    light, sheet = taken(protocol), 6.85e-3 * GRAVITY
    contradicted = set_self_weight(weighing(9.5, light), sheet)
    assert contradicted.curve.self_weight == pytest.approx(9.5e-3 * GRAVITY)
    alike = weighing(9.0, light)
    assert set_self_weight(alike, sheet) is alike
    assert set_self_weight(light, sheet).curve.self_weight == sheet
    assert not [*make_sheet_weight_notes([alike], "A2", sheet)]
    notes = [
        contradicted.notes[-1],
        *make_sheet_weight_notes([light], "A2", sheet),
        *make_sheet_weight_notes([light, alike], "A2", sheet),
    ]
    approved(f"{note.code}, {note.where}: {note.message}" for note in notes)


REST, LOADING, RATE = 4000, 1000, 20.0


NOISE_ERRORS, BLUR = 1e-3, 4e-5


SPEED = 0.05 / (LOADING / RATE)


FIRST = Branch(REST, REST + LOADING, 1, Direction.LOADING, REST / RATE, (REST + LOADING) / RATE)


PEAK_ERRORS = Result("peak_displacement.1", 0.05, "m", interval=Interval.make_normal(0.05, 1e-5))


def curve() -> Curve:
    """Rest of 200 s, with noise, and a loading at even speed."""
    random = np.random.default_rng(1)
    count = REST + LOADING
    displacement = np.concatenate([np.zeros(REST), SPEED * np.arange(LOADING) / RATE])
    displacement[:REST] += BLUR * random.standard_normal(REST)
    return Curve(
        time=np.arange(count) / RATE,
        displacement=displacement,
        force=NOISE_ERRORS * random.standard_normal(count),
        branches=(FIRST,),
    )


def result(
    aligned: Aligned | None = None, results: tuple[Result, ...] = (PEAK_ERRORS,)
) -> TestResult:
    return record_of(curve=curve(), aligned=aligned, results=results)


def joined(error: float) -> Aligned:
    """Two clocks whose offset is known to `error`, s."""
    fit = ClockFit(
        offset=1.0,
        drift=0.0,
        offset_interval=Interval.make_normal(1.0, error),
        drift_interval=Interval.make_normal(0.0, 1e-5),
        residual=0.0,
        event_times_motion=np.array([60.0]),
        event_times_force=np.array([61.0]),
        event_errors=np.array([error]),
        method="turning points",
    )
    return Aligned(curve().time, {}, fit)


def test_zeros_are_as_good_as_the_mean_over_their_part(protocol: Protocol) -> None:
    """White noise: the protocol says over which part; missing values count as absent."""
    values = NOISE_ERRORS * np.random.default_rng(2).standard_normal(6_000)
    time = np.arange(6_000) / 100.0
    assert estimate_zero_error(time, values, None) == pytest.approx(
        NOISE_ERRORS / np.sqrt(6_000), rel=0.25
    )
    assert estimate_zero_error(time, values, 2.0) == pytest.approx(
        NOISE_ERRORS / np.sqrt(200), rel=0.25
    )
    assert estimate_zero_error(time, values, 1e3) == estimate_zero_error(time, values, None)
    values[::2] = np.nan
    expected = np.sqrt(np.nanvar(values[:400]) / 200)
    assert estimate_zero_error(time[:400], values[:400], None) == pytest.approx(expected, rel=0.4)
    assert estimate_zero_error(np.arange(3.0), np.full(3, np.nan), 2.0) == 0.0
    assert estimate_force_zero_error(protocol, curve(), replace(FIRST, start=0)) == 0.0
    error = estimate_force_zero_error(protocol, curve(), FIRST)
    assert error == pytest.approx(NOISE_ERRORS / np.sqrt(2.0 * RATE), rel=0.3)
    without = protocol.model_copy(update={"steps": (), "curve": None})
    over_all = estimate_force_zero_error(without, curve(), FIRST)
    assert over_all == pytest.approx(error * np.sqrt(2.0 / (REST / RATE)), rel=0.01)


def test_a_clock_that_is_off_moves_the_deflection(protocol: Protocol) -> None:
    alone = estimate_offset_error(result(), protocol, curve(), FIRST)
    assert alone == pytest.approx(BLUR / np.sqrt(2.0 * RATE), rel=0.3)
    both = estimate_offset_error(result(joined(0.02)), protocol, curve(), FIRST)
    assert both == pytest.approx(np.hypot(alone, 0.02 * SPEED), rel=1e-3)
    assert estimate_offset_error(result(joined(np.nan)), protocol, curve(), FIRST) == alone
    short = replace(FIRST, stop=FIRST.start + 1)
    assert estimate_offset_error(result(joined(0.02)), protocol, curve(), short) == alone, (
        "has no speed"
    )


def test_the_scale_is_what_the_budget_of_the_peak_says_of_it() -> None:
    """Of 50 mm: shape 3 um and cameras 4 um are alike, offsets of 6 and -8 um are the test's."""
    rows = {
        "noise": 9e-5,
        "zero of the displacement": 2e-5,
        "shape of the wire": 3e-6,
        "scale of the displacement": -4e-6,
        "pull offset": 6e-6,
        "centre offset": -8e-6,
    }
    peak = replace(PEAK_ERRORS, budget=tuple(Contribution(*row) for row in rows.items()))
    assert estimate_scale_errors(result(results=(peak,))) == pytest.approx((1e-4, 2e-4))
    assert estimate_scale_errors(result()) == pytest.approx((2e-4, 0.0))  # all of the interval
    why = (Reason("no_cycle", "none"),)
    failed = Result(PEAK_ERRORS.name, None, "m", status=Status.FAILED, reasons=why)
    for results in ((), (failed,), (replace(PEAK_ERRORS, interval=None),)):
        assert estimate_scale_errors(result(results=results)) == (0.0, 0.0)


def number(
    name: str, value: float, error: float = 0.0, status: Status = Status.OK, **more: object
) -> Result:
    reasons = () if status is Status.OK else (Reason("drift", "it drifts"),)
    interval = Interval.make_normal(value, error)
    return Result(name, value, "1", interval, status, reasons, **more)  # type: ignore[arg-type]


SCALE = Contribution("scale of the force", 0.01, is_common=True)
CYCLES = (
    number("peak_displacement.1", PEAK),
    number("peak_displacement.2", PEAK),
    number("residual_displacement.1", 0.0115, 1e-4),
    number("energy.1", 1.04e-3, 1e-5),
    number("peak_force.1", 0.20, budget=(SCALE, Contribution("noise", 0.002))),
    number("peak_force.2", 0.21, budget=(SCALE, Contribution("noise", 0.002))),
)


def test_what_cycles_leave_without_the_scale_of_the_force(protocol: Protocol) -> None:
    cycles = taken(protocol, result_of(results=CYCLES)).cycles
    assert cycles is not None
    assert (cycles.length, cycles.peak) == (LENGTH, PEAK)
    weighed = set_self_weight(taken(protocol, result_of(results=CYCLES)), 0.07)
    assert weighed.cycles == replace(cycles, self_weight=weighed.curve.self_weight)
    assert weighed.curve.self_weight == 0.07
    assert cycles.measures["residual"] == pytest.approx((0.0115, 1e-4))
    assert cycles.measures["energy"] == pytest.approx((1.04e-3, 1e-5))
    own = 1.05 * np.hypot(0.002 / 0.20, 0.002 / 0.21)
    assert cycles.measures["ratio"] == pytest.approx((1.05, own))


@pytest.mark.parametrize(
    ("changed", "left", "code"),
    [
        ({1: number("peak_displacement.2", 1.02 * PEAK)}, {"residual", "energy"}, "cycles_grow"),
        (
            {2: number("residual_displacement.1", 0.01, status=Status.DOUBTFUL)},
            {"energy", "ratio"},
            "",
        ),
        ({1: number("other", 1.0), 5: number("another", 1.0)}, {"residual", "energy"}, ""),
        ({0: number("other", 1.0)}, None, ""),
    ],
    ids=["growing", "doubtful", "one-cycle", "no-peak"],
)
def test_cycles_that_cannot_be_used(
    protocol: Protocol, changed: dict[int, Result], left: set[str] | None, code: str
) -> None:
    results = [changed.get(place, result) for place, result in enumerate(CYCLES)]
    loading = taken(protocol, result_of(results=tuple(results)))
    assert (loading.cycles and set(loading.cycles.measures)) == left
    assert ("cycles_grow" in {note.code for note in loading.notes}) == (code == "cycles_grow")
