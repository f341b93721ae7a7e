"""First loadings out of processed tests: which points, with which noise, and which tests not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.protocol.load import load_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.curve import Aligned, Branch, Curve, Direction, Series
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.result import Result, Specimen, Status, TestResult
from labpipe.studies.first_loadings import (
    FirstLoading,
    NotUsableError,
    first_loading,
    noise_of,
    read_first_loadings,
    weight_note,
    with_weight,
)
from labpipe.units import GRAVITY

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
