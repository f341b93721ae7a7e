from __future__ import annotations

from dataclasses import replace

import pytest

from labpipe.records.harness_bundle import Bundle
from labpipe.records.quality import Reason, worded
from labpipe.records.result import Result, Status
from labpipe.studies.bundle_bounds import find_places
from labpipe.studies.wire_specs import read_wire_sheet
from labpipe.wire.bundle_model import bundle_model
from tests.builders.bundle_campaigns import bundle_of, bundle_sample, grouped, three_of
from tests.builders.bundles import EXAMPLES, example_wires

WIRES = read_wire_sheet(EXAMPLES)
SEVEN = bundle_of("7 B1", conduit="corrugated-tube", conduit_bore=0.0107)


def test_samples_and_mean_between_the_bounds_of_the_model() -> None:
    model = bundle_model(Bundle(SEVEN.wires), example_wires())
    *samples, mean = find_places(grouped(three_of(SEVEN)), WIRES)
    assert [place.test for place in (*samples, mean)] == [*(f"{mean.group}-{n}" for n in "123"), ""]
    for place in (*samples, mean):
        assert (place.low, place.free, place.high) == (model.low, model.free, model.high)
        assert place.principal == model.principal
        assert place.value is not None
        assert place.interval is not None
        assert place.share_interval is not None
        span = model.high - model.low
        assert place.share == pytest.approx((place.value - model.low) / span)
        assert place.share_interval.upper == pytest.approx(
            (place.interval.upper - model.low) / span
        )
        assert place.reasons == ()
    assert mean.value == pytest.approx(sum(place.value or 0.0 for place in samples) / 3)


def test_a_wire_that_the_sheet_lacks() -> None:
    places = list(find_places(grouped([bundle_sample(bundle_of("4 B3 + 3 B1"), 1)]), WIRES))
    assert [worded(place.reasons) for place in places] == [
        "not_in_sheet: no bounds: the sheet has no B3"
    ] * 2
    assert places[0].value is not None


def test_positions_that_overlap_have_no_bounds() -> None:
    bundle = bundle_of("2 B1", positions=((0.0, 0.0), (1e-4, 0.0)))
    (sample, _) = find_places(grouped([bundle_sample(bundle, 1)]), WIRES)
    assert worded(sample.reasons).startswith("no_model: no bounds: ")


def test_a_wire_that_cannot_be_modelled() -> None:
    odd = [replace(wire, insulation_thickness=1.0) for wire in WIRES if wire.name == "B1"]
    (sample, _) = find_places(grouped([bundle_sample(SEVEN, 1)]), odd)
    assert worded(sample.reasons).startswith(
        "no_law: no bounds: B1 of the sheet cannot be modelled: "
    )


def test_a_group_of_two_compositions_has_no_bounds_of_its_mean() -> None:
    samples = [bundle_sample(SEVEN, 1), bundle_sample(bundle_of("12 B1"), 2)]
    one, two, mean = find_places(grouped(samples, "wire"), WIRES)
    assert 0.0 < one.low < two.low
    assert worded(mean.reasons) == "bundles_differ: no bounds: its samples differ in them"


def test_without_a_stiffness() -> None:
    sample = bundle_sample(SEVEN, 1)
    reasons = (Reason("not_reached", "the branch ends at 1 mm"),)
    failed = Result("bending_stiffness", None, "N*m^2", status=Status.FAILED, reasons=reasons)
    for results, why in (
        ((failed,), worded(reasons)),
        ((), "no_result: the test has no bending_stiffness"),
    ):
        one, mean = find_places(grouped([replace(sample, results=results)]), WIRES)
        assert (one.value, worded(one.reasons)) == (None, why)
        assert one.low > 0.0
        assert (mean.value, worded(mean.reasons)) == (
            None,
            "no_result: no sample has a bending_stiffness",
        )


def test_what_is_no_bundle_has_no_place() -> None:
    assert not list(find_places(grouped([bundle_sample(None, 1)]), WIRES))
    together = grouped([bundle_sample(None, 1), bundle_sample(SEVEN, 2)], "length")
    places = {place.test: worded(place.reasons) for place in find_places(together, WIRES)}
    assert places["tube-1"] == "no_bundle: no bounds: its test sheet says no bundle"
