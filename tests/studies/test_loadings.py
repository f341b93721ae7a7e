from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from openpyxl import Workbook, load_workbook
from scipy.integrate import quad
from scipy.optimize import brentq

from labpipe.cli import main
from labpipe.errors import ReadError
from labpipe.protocol.load import load_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.curve import Aligned, Branch, ClockFit, Curve, Direction, Interval, Series
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.result import Contribution, Result, Specimen, Status, TestResult
from labpipe.studies.first_loadings import (
    FirstLoading,
    NotUsableError,
    first_loading,
    force_zero_error,
    noise_of,
    place_error,
    read_first_loadings,
    scale_errors,
    weight_note,
    with_weight,
    zero_error,
)
from labpipe.studies.stress_tables import Conditions, ProofStress, ramberg_osgood_curve
from labpipe.studies.wire_specs import read_wire_sheet, read_wires
from labpipe.units import GRAVITY
from labpipe.wire.materials import RambergOsgood
from labpipe.wire.wire_table import wire_table
from tests.builders.wire_tables import spec_of

LENGTH, PEAK, COUNT = 0.085, 0.05, 2000


NOISE = 1e-3


def result_of(**changes: object) -> TestResult:
    """A test of one cycle: force rises with the root of the deflection."""
    random = np.random.default_rng(1)
    up = np.linspace(-0.1e-3, PEAK, COUNT)
    displacement = np.concatenate([up, up[::-1]])
    force = 0.2 * np.sqrt(np.maximum(displacement, 0.0) / PEAK)
    force = force + NOISE * random.standard_normal(len(force))
    branch = np.repeat([0, 1], COUNT)
    curve = Curve(
        time=np.arange(2 * COUNT) / 100.0,
        displacement=displacement,
        force=force,
        branch=branch,
        cycle=np.ones(2 * COUNT, dtype=np.int64),
        branches=(
            Branch(0, COUNT, 1, Direction.LOADING, 0.0, 20.0),
            Branch(COUNT, 2 * COUNT, 1, Direction.UNLOADING, 20.0, 40.0),
        ),
    )
    made = TestResult(
        test="T1",
        specimen=Specimen("A2", "A2-s1", "3", {"length": LENGTH}),
        protocol="wire-cantilever",
        protocol_yaml="",
        test_yaml="",
        labpipe_version="0",
        inputs=(),
        recordings={},
        aligned=None,
        curve=curve,
        shape=None,
        results=(Result("peak_force.1", 0.2, "N"),),
        quality=(),
    )
    return replace(made, **changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def protocol(repository: Path) -> Protocol:
    return load_protocol(repository / "protocols" / "wire-cantilever.yaml")


def taken(protocol: Protocol, result: TestResult | None = None, **asked: float) -> FirstLoading:
    return first_loading(result or result_of(), protocol, points=200, up_to=asked.get("up_to"))


def test_points_are_means_of_the_first_loading_alone(protocol: Protocol) -> None:
    curve = taken(protocol).curve
    assert (curve.wire, curve.test, curve.sample) == ("A2", "T1", "A2-s1, sample 3")
    assert np.all(np.diff(curve.deflection) > 0.0)
    assert curve.deflection[0] > 0.0
    assert 190 <= len(curve.deflection) <= 400
    truth = 0.2 * np.sqrt(curve.deflection / PEAK)
    assert np.std(curve.force[20:] - truth[20:]) < 0.5 * NOISE


def test_noise_is_that_of_the_means(protocol: Protocol) -> None:
    curve = taken(protocol).curve
    each = NOISE / np.sqrt(COUNT / 200)
    assert 0.7 * each < float(np.min(curve.noise))
    assert float(np.mean(curve.noise)) < 1.6 * each


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


def test_white_noise_on_a_parabola() -> None:
    at = np.linspace(0.0, 1.0, 20_000)
    noise = 0.01 * np.random.default_rng(4).standard_normal(len(at))
    assert noise_of(3.0 * at**2 + noise) == pytest.approx(0.01, rel=0.03)


def test_rig_and_gain_are_those_of_the_protocol(protocol: Protocol) -> None:
    found = taken(protocol)
    assert found.gain == pytest.approx(0.002)
    rig = found.curve.rig
    assert rig is not None
    assert rig.string_length == rig.anchor_height == pytest.approx(0.76)
    assert rig.weight == pytest.approx(2.7e-3 * GRAVITY)
    assert rig.anchor_x == pytest.approx(LENGTH)


def test_no_string_no_rig(protocol: Protocol) -> None:
    without = protocol.model_copy(update={"rig": protocol.rig.model_copy(update={"string": None})})
    assert taken(without).curve.rig is None


def test_what_lies_beyond_the_limit_is_left_out_and_told(protocol: Protocol) -> None:
    found = taken(protocol, up_to=0.02)
    assert found.curve.deflection.max() <= 0.02
    _, note = found.notes
    assert note.code == "loading_cut"
    assert note.message.endswith("what lies beyond 20 mm was left out")


def test_doubtful_tests_are_taken_and_told(protocol: Protocol) -> None:
    doubtful = Result(
        "peak_force.1",
        0.2,
        "N",
        status=Status.DOUBTFUL,
        reasons=(Reason("gap", "a marker was lost"),),
    )
    note, _ = taken(protocol, result_of(results=(doubtful,))).notes
    assert (note.code, note.where) == ("test_doubtful", "T1")
    assert note.message == "taken as it is: gap: a marker was lost"


def test_without_a_curve(protocol: Protocol) -> None:
    with pytest.raises(NotUsableError, match="it has no curve: look at its summary"):
        taken(protocol, result_of(curve=None))


def test_without_a_loading(protocol: Protocol) -> None:
    curve = result_of().curve
    assert curve is not None
    only_back = replace(curve, branches=curve.branches[1:])
    with pytest.raises(NotUsableError, match="it has no first loading"):
        taken(protocol, result_of(curve=only_back))


def test_a_failed_first_loading(protocol: Protocol) -> None:
    failed = Result(
        "peak_force.1", None, "N", status=Status.FAILED, reasons=(Reason("no_cycle", "none"),)
    )
    with pytest.raises(NotUsableError, match="its first loading failed: no_cycle: none"):
        taken(protocol, result_of(results=(failed,)))


def test_without_a_length(protocol: Protocol) -> None:
    unknown = protocol.model_copy(
        update={"specimen": protocol.specimen.model_copy(update={"length": None})}
    )
    with pytest.raises(NotUsableError, match="the free length is not known"):
        taken(unknown, result_of(specimen=Specimen("A2", "s", "1")))


def test_too_few_points(protocol: Protocol) -> None:
    with pytest.raises(
        NotUsableError, match="20 at least are needed; ask for more points, or for deeper ones"
    ):
        taken(protocol, up_to=1e-3)


def test_a_test_that_is_no_cantilever(repository: Path) -> None:
    pulled = load_protocol(repository / "protocols" / "corrugated-tube.yaml")
    told = r"it is no cantilever test: its protocol, corrugated-tube, has neither a string \(rig"
    with pytest.raises(NotUsableError, match=told):
        taken(pulled)


def test_a_wire_of_which_nothing_is_known_at_rest(protocol: Protocol) -> None:
    (note,) = taken(protocol).notes
    assert (note.code, note.where) == ("rest_unknown", "T1")


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
    said = "zeroed from 0.00 s to 2.00 s of the motion's clock, but the clamp moves from 1.00 s"
    lost = result_of(quality=(QualityNote(code, Severity.WARNING, "force", said),))
    with pytest.raises(NotUsableError, match=rf"its zero is lost.*force: zeroed.*\({code}\)"):
        taken(protocol, lost)
    other = result_of(quality=(QualityNote("gap", Severity.WARNING, "force", "a gap"),))
    assert taken(protocol, other).curve.test == "T1"


def test_files_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    broken = tmp_path / "T1" / "result.h5"
    broken.parent.mkdir()
    broken.write_bytes(b"none")
    told: list[str] = []
    found, left_out = read_first_loadings([broken], points=200, say=told.append)
    assert not found
    assert told == ["T1"]
    assert str(broken) in left_out[str(broken)]


def weighing(grams: float, loading: FirstLoading) -> FirstLoading:
    """A test whose sheet says so many grams per metre; 0 for one that says none."""
    curve = replace(loading.curve, self_weight=1e-3 * grams * GRAVITY)
    return replace(loading, curve=curve)


def test_a_mass_that_contradicts_the_sheet_of_wires_is_said(protocol: Protocol) -> None:
    """The test's own is taken; more than a third off is said, with both numbers."""
    light, sheet = taken(protocol), 6.85e-3 * GRAVITY
    found = with_weight(weighing(9.5, light), sheet)
    (said,) = [note for note in found.notes if note.code == "mass_contradicts"]
    assert said.where == "T1"
    assert said.message == (
        "its sheet says 9.5 g/m (specimen.mass_per_length), the sheet of wires 6.85 g/m for A2: "
        "that of the test is taken"
    )
    assert found.curve.self_weight == pytest.approx(9.5e-3 * GRAVITY)
    alike = weighing(9.0, light)
    assert with_weight(alike, sheet) is alike
    assert with_weight(light, sheet).curve.self_weight == sheet


def test_tests_without_a_mass_have_that_of_the_sheet_of_wires_and_it_is_said(
    protocol: Protocol,
) -> None:
    light, sheet = taken(protocol), 6.85e-3 * GRAVITY
    heavy = weighing(7.0, light)
    assert weight_note([heavy], sheet) is None
    note = weight_note([light], sheet)
    assert note is not None
    assert (note.code, note.where) == ("weight_of_sheet", "A2")
    assert note.message.startswith("no test sheet says a mass per length (specimen.mass_per_lengt")
    assert "6.85 g/m" in note.message
    some = weight_note([light, heavy], sheet)
    assert some is not None
    assert some.message.startswith("1 of 2 test sheets do not say a mass")


REST, LOADING, RATE = 4000, 1000, 20.0


NOISE_ERRORS, BLUR = 1e-3, 4e-5


SPEED = 0.05 / (LOADING / RATE)


FIRST = Branch(REST, REST + LOADING, 1, Direction.LOADING, REST / RATE, (REST + LOADING) / RATE)


PEAK_ERRORS = Result("peak_displacement.1", 0.05, "m", interval=Interval.normal_95(0.05, 1e-5))


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
        branch=np.repeat([-1, 0], [REST, LOADING]),
        cycle=np.repeat([0, 1], [REST, LOADING]),
        branches=(FIRST,),
    )


def result(
    aligned: Aligned | None = None, results: tuple[Result, ...] = (PEAK_ERRORS,)
) -> TestResult:
    return TestResult(
        test="T1",
        specimen=Specimen("A2", "A2-s1", "1"),
        protocol="wire-cantilever",
        protocol_yaml="",
        test_yaml="",
        labpipe_version="0",
        inputs=(),
        recordings={},
        aligned=aligned,
        curve=curve(),
        shape=None,
        results=results,
        quality=(),
    )


def joined(error: float) -> Aligned:
    """Two clocks whose offset is known to `error`, s."""
    fit = ClockFit(
        offset=1.0,
        drift=0.0,
        offset_interval=Interval.normal_95(1.0, error),
        drift_interval=Interval.normal_95(0.0, 1e-5),
        residual=0.0,
        event_times_motion=np.array([60.0]),
        event_times_force=np.array([61.0]),
        event_errors=np.array([error]),
        method="turning points",
    )
    return Aligned(curve().time, {}, fit)


def test_zero_of_white_noise_is_that_of_the_mean_over_the_part() -> None:
    values = NOISE_ERRORS * np.random.default_rng(2).standard_normal(20_000)
    time = np.arange(20_000) / 100.0
    assert zero_error(time, values, None) == pytest.approx(NOISE_ERRORS / np.sqrt(20_000), rel=0.25)
    assert zero_error(time, values, 2.0) == pytest.approx(NOISE_ERRORS / np.sqrt(200), rel=0.25)
    assert zero_error(time, values, 1e3) == zero_error(time, values, None)


def test_missing_values_at_rest_count_as_absent() -> None:
    values = NOISE_ERRORS * np.random.default_rng(2).standard_normal(400)
    values[::2] = np.nan
    time = np.arange(400) / 100.0
    known = np.sqrt(np.nanvar(values) / 200)
    assert zero_error(time, values, None) == pytest.approx(known, rel=0.4)


def test_without_a_rest_nothing_is_known_of_a_zero(protocol: Protocol) -> None:
    assert zero_error(np.zeros(0), np.zeros(0), 2.0) == 0.0
    assert zero_error(np.arange(3.0), np.full(3, np.nan), 2.0) == 0.0
    at_once = replace(FIRST, start=0)
    assert force_zero_error(protocol, curve(), at_once) == 0.0


def test_the_protocol_says_over_which_stretch_zeros_are_taken(protocol: Protocol) -> None:
    found = force_zero_error(protocol, curve(), FIRST)
    assert found == pytest.approx(NOISE_ERRORS / np.sqrt(2.0 * RATE), rel=0.3)
    without = protocol.model_copy(update={"steps": (), "curve": None})
    over_all = force_zero_error(without, curve(), FIRST)
    assert over_all == pytest.approx(found * np.sqrt(2.0 / (REST / RATE)), rel=0.01)


def test_a_clock_that_is_off_moves_the_deflection(protocol: Protocol) -> None:
    alone = place_error(result(), protocol, curve(), FIRST)
    assert alone == pytest.approx(BLUR / np.sqrt(2.0 * RATE), rel=0.3)
    both = place_error(result(joined(0.02)), protocol, curve(), FIRST)
    assert both == pytest.approx(np.hypot(alone, 0.02 * SPEED), rel=1e-3)
    assert place_error(result(joined(np.nan)), protocol, curve(), FIRST) == alone


def test_a_loading_of_one_point_has_no_speed(protocol: Protocol) -> None:
    short = replace(FIRST, stop=FIRST.start + 1)
    alone = place_error(result(), protocol, curve(), FIRST)
    assert place_error(result(joined(0.02)), protocol, curve(), short) == alone


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
    known = replace(PEAK_ERRORS, budget=tuple(Contribution(*row) for row in rows.items()))
    assert scale_errors(result(results=(known,))) == pytest.approx((1e-4, 2e-4))


def test_without_a_budget_all_of_the_interval_counts() -> None:
    assert scale_errors(result()) == pytest.approx((2e-4, 0.0))
    assert scale_errors(result(results=())) == (0.0, 0.0)
    failed = Result(
        PEAK_ERRORS.name, None, "m", status=Status.FAILED, reasons=(Reason("no_cycle", "none"),)
    )
    assert scale_errors(result(results=(failed,))) == (0.0, 0.0)
    assert scale_errors(result(results=(replace(PEAK_ERRORS, interval=None),))) == (0.0, 0.0)


HEADING = "wire,wire_diameter_mm,strands,strand_diameter_mm,lay_angles_deg,insulation_thickness_mm"


NUMBERS = "modulus_mpa,proof_stress_mpa,exponent,largest_strain"


PVC = ProofStress(modulus_mpa="900", proof_stress_mpa="11", exponent="4", largest_strain="0.08")


def strain_of(numbers: ProofStress, stress: float) -> float:
    """The formula as data sheets have it, MPa."""
    over = float(stress / numbers.proof_stress_mpa)
    return stress / numbers.modulus_mpa + float(0.002 * over**numbers.exponent)


def stress_of(numbers: ProofStress, strain: float) -> float:
    """The formula inverted, MPa."""
    most = 1.000001 * numbers.modulus_mpa * strain
    return float(brentq(lambda stress: strain_of(numbers, stress) - strain, 0.0, most, xtol=1e-13))


@pytest.mark.parametrize(
    ("modulus", "proof", "exponent", "largest"),
    [
        ("900", "11", "4", "0.08"),
        ("20", "1.5", "1.5", "0.5"),
        ("1000", "10", "1.1", "0.1"),
        ("3000", "40", "12", "0.2"),
        ("2500", "55", "100", "0.6"),
        ("110000", "54", "2.9", "0.3"),
    ],
)
def test_straight_lines_are_on_the_formula(
    modulus: str, proof: str, exponent: str, largest: str
) -> None:
    numbers = ProofStress(
        modulus_mpa=modulus, proof_stress_mpa=proof, exponent=exponent, largest_strain=largest
    )
    strains, stresses = ramberg_osgood_curve(numbers)
    assert len(strains) <= 60
    assert strains[-1] == float(largest)
    assert stresses[-1] == pytest.approx(1e6 * stress_of(numbers, strains[-1]), rel=1e-9)
    some = np.geomspace(1e-4, 1.0, 200) * strains[-1]
    lines = np.interp(some, (0.0, *strains), (0.0, *stresses))
    exact = 1e6 * np.array([stress_of(numbers, strain) for strain in some])
    assert np.all(lines <= exact * (1.0 + 1e-9))
    assert lines == pytest.approx(exact, rel=1e-3)
    assert stresses[0] / strains[0] <= 1e6 * numbers.modulus_mpa


def test_the_proof_stress_leaves_two_thousandths() -> None:
    strains, stresses = ramberg_osgood_curve(PVC)
    strain = float(np.interp(11e6, stresses, strains))
    assert strain - 11e6 / 900e6 == pytest.approx(0.002, abs=1e-5)


def test_it_is_the_curve_of_the_copper_in_other_words() -> None:
    copper = RambergOsgood(110e9, 530e6, 0.44)
    proof = f"{530.0 * 0.002**0.44:.12g}"
    numbers = ProofStress(
        modulus_mpa="110000",
        proof_stress_mpa=proof,
        exponent=f"{1 / 0.44:.12g}",
        largest_strain="0.1",
    )
    strains, stresses = ramberg_osgood_curve(numbers)
    assert copper.stress(np.array(strains)) == pytest.approx(stresses, rel=1e-9)


def test_the_law_of_a_wire_is_that_of_a_dense_table_and_of_the_formula() -> None:
    spec = spec_of("A2", "A2")
    stress = np.linspace(0.0, stress_of(PVC, 0.08), 3001)[1:]
    strain = [strain_of(PVC, each) for each in stress]
    dense = wire_table(replace(spec, insulation_table=(tuple(strain), tuple(1e6 * stress))))
    made = wire_table(replace(spec, insulation_table=ramberg_osgood_curve(PVC)))
    assert made.curvature[-1] == pytest.approx(100.0)
    end = dense.curvature[-1] * (1.0 - 1e-9)
    shared = made.curvature[made.curvature < end]
    for law in ("moment", "insulation"):
        other = np.interp(shared, dense.curvature, getattr(dense, law))
        assert getattr(made, law)[: len(shared)] == pytest.approx(other, rel=1e-3)
    assert np.interp(0.05, made.tip_deflection, made.tip_force) == pytest.approx(
        np.interp(0.05, dense.tip_deflection, dense.tip_force), rel=1e-3
    )
    outer, bore = 0.8e-3, 0.5e-3
    for curvature in (5.0, 25.0, 90.0):
        by_hand = _bar(PVC, outer, curvature) - _bar(PVC, bore, curvature)
        found = float(np.interp(curvature, made.curvature, made.insulation))
        assert found == pytest.approx(by_hand, rel=2e-3)


def _bar(numbers: ProofStress, radius: float, curvature: float) -> float:
    """Moment of a full bar, N m: stresses of the formula summed up over its height."""

    def lamina(height: float) -> float:
        width = 2.0 * np.sqrt(radius**2 - height**2)
        return float(1e6 * stress_of(numbers, curvature * height) * height * width)

    return 2.0 * float(quad(lamina, 0.0, radius, epsrel=1e-8)[0])


def written(folder: Path, *lines: str, column: str = "insulation_table") -> Path:
    sheet = folder / "wires.csv"
    sheet.write_text(f"{HEADING},{column}\nA2,1.6,7,0.32,12,0.3,pvc.csv\n")
    (folder / "pvc.csv").write_text("\n".join(lines))
    return sheet


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["-900,11,4,0.08"], "line 2, column 1 (modulus_mpa): expected a number from 0.1 to"),
        (["900,-11,4,0.08"], "line 2, column 2 (proof_stress_mpa): expected a number from 0.001"),
        (["900,11,0.8,0.08"], "line 2, column 3 (exponent): expected a number from 1.1 to 100, f"),
        (["900,11,4,0.8"], "line 2, column 4 (largest_strain): expected a number from 0.0001 to"),
        (["900,11,4,"], "line 2, column 4 (largest_strain): expected a number from 0.0001 to 0"),
        (
            ["900,11,4,0.01"],
            "line 2, column 4 (largest_strain): expected a largest strain of 0.01422 or more, where"
            " the proof stress is reached, found 0.01. Give the range of the test that the numbers"
            " come from.",
        ),
        (
            ["11000,11,4,0.1"],
            "line 2, column 1 (modulus_mpa): expected a modulus of insulation of 0.1 to 10000 MPa,"
            " found 11000 MPa. Is the unit right?",
        ),
        (
            ["900,11,4,0.08", "800,11,4,0.08"],
            "line 3, column 1: expected one row of numbers, found 2. Make a table of each.",
        ),
    ],
)
def test_numbers_that_are_refused(tmp_path: Path, lines: list[str], said: str) -> None:
    with pytest.raises(ReadError) as refused:
        read_wire_sheet(written(tmp_path, NUMBERS, *lines))
    assert str(refused.value).startswith(f"{tmp_path / 'pvc.csv'}, {said}")


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (
            ["modulus_mpa,exponent,largest_strain", "900,4,0.1"],
            "line 1, column 1: expected a column 'proof_stress_mpa', found 'modulus_mpa', 'expone",
        ),
        (
            [f"{NUMBERS},strain", "900,11,4,0.08,1"],
            "line 1, column 5: expected either points or numbers, so no column 'strain' beside",
        ),
        (
            [f"{NUMBERS},exponent", "900,11,4,0.08,4"],
            "line 1, column 5: expected each column once, found 'exponent' again. Remove one.",
        ),
        (
            ["strain,stress_mpa,temperature", "0.01,10,23"],
            "line 1, column 3: expected a column 'temperature_c', found 'temperature'. Give it in",
        ),
        (
            ["strain,stress_mpa,rate_per_min", "0.01,10,23"],
            "line 1, column 3: expected a column 'strain_rate_per_s', found 'rate_per_min'. Give",
        ),
        (
            ["strain,stress_mpa,temperature_c", "0.01,10,23", "0.1,20,40"],
            "line 3, column 3 (temperature_c): expected '23' as in line 2, column 3: one for the w",
        ),
        (
            ["strain,stress_mpa,temperature_c", "0.01,10,cold"],
            "line 2, column 3 (temperature_c): expected a number from -100 to 400 degC, found 'co",
        ),
        (
            ["strain,stress_mpa", "0.01,10", "0.05,8"],
            "line 3, column 2 (stress_mpa): expected a stress of 10 MPa or more, and more than zer",
        ),
        (
            ["strain,stress_mpa", "0.01,10", "0.01,12"],
            "line 3, column 1 (strain): expected a strain above 0.01, found 0.01. Put the rows in",
        ),
    ],
)
def test_tables_that_are_refused(tmp_path: Path, lines: list[str], said: str) -> None:
    with pytest.raises(ReadError) as refused:
        read_wire_sheet(written(tmp_path, *lines))
    assert str(refused.value).startswith(f"{tmp_path / 'pvc.csv'}, {said}")


def test_rate_and_temperature_of_points_stand_in_any_row(tmp_path: Path) -> None:
    heading = "strain,stress_mpa,from,temperature_c,strain_rate_per_s"
    sheet = read_wires(written(tmp_path, heading, "0.01,10,us,23,", "0.1,20,us,,1e-3"))
    curve = sheet.curves["A2"]["insulation_table"]
    assert curve.words == ("'pvc.csv': 2 points, to a strain of 0.1, at 0.001 1/s and 23 \u00b0C")
    assert sheet.specs[0].insulation_table == curve.curve == ((0.01, 0.1), (10e6, 20e6))
    silent = read_wires(written(tmp_path, "strain,stress_mpa", "0.01,10"))
    [said] = silent.curves["A2"].values()
    assert said.words.endswith("1 point, to a strain of 0.01, rate and temperature not stated")
    assert said.as_json()["temperature"] is None


def test_numbers_may_stand_for_the_strands_too(tmp_path: Path) -> None:
    path = written(tmp_path, NUMBERS, "110000,54,2.3,0.2", column="stress_table")
    [spec] = read_wire_sheet(path)
    assert spec.stress_table is not None
    assert spec.stress_table[0][-1] == 0.2
    with pytest.raises(ReadError, match="a modulus of strands of 1000 to 1e\\+06 MPa, found 900"):
        read_wire_sheet(written(tmp_path, NUMBERS, "900,11,4,0.08", column="stress_table"))


def test_the_model_carries_what_a_sheet_of_a_workbook_states(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    book = Workbook()
    page, table = book.active, book.create_sheet("PVC")
    assert page is not None
    page.append([*HEADING.split(","), "insulation_table"])
    page.append(["A2", 1.6, 7, 0.32, 12, 0.3, "pvc"])
    table.append([*NUMBERS.split(","), "strain_rate_per_s", "temperature_c"])
    table.append([900, 11, 4, 0.08, 0.001, 23])
    book.save("wires.xlsx")
    assert main(["model", "wires.xlsx", "--no-figures"]) == 0
    words = (
        "insulation_table 'pvc': Ramberg-Osgood, modulus 900 MPa, proof stress 11 MPa, exponent 4,"
        " to a strain of 0.08, at 0.001 1/s and 23 \u00b0C"
    )
    assert f"  info: {words}  [A2]\n" in capsys.readouterr().out
    model = json.loads(Path("processed/wires/model.json").read_text())
    said = model["wires"]["A2"]["stress_tables"]["insulation_table"]
    assert (said["modulus"], said["proof_stress"]) == (900e6, 11e6)
    assert (said["strain_rate"], said["temperature"]) == (0.001, pytest.approx(296.15))
    assert said["strain"][-1] == 0.08
    heads, row = load_workbook("processed/wires/wires.xlsx")["wires"].iter_rows(values_only=True)
    assert dict(zip(heads, row, strict=True))["stress tables"] == words


def test_every_column_is_documented_with_its_range(repository: Path) -> None:
    page = (repository / "docs" / "how-to" / "wire-sheet.md").read_text(encoding="utf-8")
    for kind in (ProofStress, Conditions):
        for name, field in kind.model_fields.items():
            [column] = field.metadata
            least = 0.1 if name == "modulus_mpa" else column.least
            most = 10000.0 if name == "modulus_mpa" else column.most
            assert f"`{name}` | {least:g} to {most:.10g}" in page
