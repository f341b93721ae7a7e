"""Groups: how samples are divided, what enters and is left out, notes, budgets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.curve import SlipDecision
from labpipe.records.group import Group, GroupNumber, Sample, SampleCurve, Verdict
from labpipe.records.harness_bundle import Bundle
from labpipe.records.quality import Reason, Severity, worded
from labpipe.records.result import Contribution, Result, Status
from labpipe.statistics.group_budgets import SCATTER, group_budget
from labpipe.statistics.group_division import Part, divide
from labpipe.statistics.group_fields import (
    differing_fields,
)
from labpipe.statistics.group_fields import in_order as field_order
from labpipe.statistics.group_notes import (
    grouping_notes,
    method_notes,
    otherwise_made,
    sample_notes,
)
from labpipe.statistics.groups import build_group, compare_groups
from labpipe.statistics.means import nested_mean
from labpipe.statistics.shared_causes import with_shared
from labpipe.statistics.two_groups import judged
from tests.approved import Approve
from tests.builders.bundle_campaigns import bundle_of, bundle_sample
from tests.builders.campaigns import build_sample, built, make, said, samples, stiffness


def test_numbers_and_band_of_two_spools() -> None:
    group = built(samples())
    number = group.numbers[0]
    assert (number.name, number.unit, len(number.values)) == ("stiffness", "N/m", 6)
    assert number.mean is not None
    assert number.mean.chosen.mean == pytest.approx(52.28)
    assert not number.left_out
    assert (group.band.n, group.band.over) == (2, "spool means")
    np.testing.assert_allclose(group.band.mean, 52.28 * group.band.displacement)
    assert "not pooled over 6 samples" in said(group)["curve_pooling"]
    assert group.band_scaled is None


def test_order_of_samples_does_not_matter() -> None:
    one, two = built(samples()), built(samples()[::-1])
    assert [sample.test for sample in one.samples] == [sample.test for sample in two.samples]
    assert one.numbers == two.numbers


def test_what_is_left_out_says_why() -> None:
    broken, other, without, odd = (make("s1", number, 50.0 + number) for number in range(4))
    failed = stiffness(
        None, status=Status.FAILED, reasons=(Reason("too_few_samples", "3 samples"),)
    )
    members = [
        make("s0", 1, 50.0),
        replace(broken, results=(failed,)),
        replace(other, results=(stiffness(1.0, "N/mm"),)),
        replace(without, results=()),
        replace(odd, results=(stiffness(float("inf")),)),
    ]
    number = built(members).numbers[0]
    assert list(number.values) == ["s0-1"]
    assert {test: worded(why) for test, why in number.left_out.items()} == {
        "s1-0": "too_few_samples: 3 samples",
        "s1-1": "other_unit: in N/mm, where the first sample is in N/m",
        "s1-2": "no_result: the test has no stiffness",
        "s1-3": "not_finite: the value is inf",
    }


def test_groups_are_compared_in_what_both_have() -> None:
    first, second = built(samples()[:3]), built(samples()[3:])
    found = compare_groups(first, second, names=["stiffness", "energy"], margin=0.1)
    assert [finding.name for finding in found] == ["stiffness"]
    assert found[0].difference.mean == pytest.approx(47.12 - 57.44)
    assert found[0].margin == pytest.approx(5.744)
    assert found[0].verdict is Verdict.NOT_ASKED
    assert judged("one", found)[0].verdict is Verdict.DIFFERENT
    every = compare_groups(first, second)
    assert [each.name for each in every] == ["stiffness", "peak_force.1"]
    assert every[0].margin is None
    assert np.isnan(every[0].p_equivalent)


def wires(*lengths: float | None, **labels: Sequence[str]) -> list[Sample]:
    """Samples of one type with lengths in mm, and a word of each label."""
    base = bundle_sample(None, 1)
    return [
        replace(
            base,
            test=f"t{at}",
            specimen=replace(
                base.specimen,
                sample=str(at),
                dimensions={} if length is None else {"length": 1e-3 * length},
                labels={name: words[at] for name, words in labels.items()},
            ),
        )
        for at, length in enumerate(lengths)
    ]


def divided(parts: Sequence[Part]) -> list[tuple[Mapping[str, str], list[str]]]:
    return [(part.fields, [sample.test for sample in part.samples]) for part in parts]


def test_two_lengths_are_two_parts() -> None:
    assert divided(divide(wires(85, 100, 85, 100.4))) == [
        ({"length": "85 mm"}, ["t0", "t2"]),
        ({"length": "100.2 mm"}, ["t1", "t3"]),
    ]


def test_lengths_that_were_measured_stay_together() -> None:
    assert len(divide(wires(96, 104, 100))) == 1  # no two neighbours more than 5 % apart
    assert len(divide(wires(96, 104))) == 2
    assert len(divide(wires(100, 104.9))) == 1
    assert len(divide(wires(100, 105.1))) == 2


def test_a_length_that_is_not_said_is_another_one() -> None:
    assert [part.fields for part in divide(wires(85, None))] == [
        {"length": "85 mm"}, {"length": "not said"}
    ]  # fmt: skip


def test_a_label_divides_unless_it_names_each_test() -> None:
    aged = wires(85, 85, 85, aged=["0 h", "500 h", "0 h"])
    assert divided(divide(aged)) == [({"aged": "0 h"}, ["t0", "t2"]), ({"aged": "500 h"}, ["t1"])]
    assert len(divide(wires(85, 85, 85, serial=["a", "b", "c"]))) == 1


def group(*samples: Sample) -> Group:
    return build_group("any", "taped-bundle", samples)


def of(bundle: Bundle | None, **more: object) -> Group:
    return group(bundle_sample(bundle, 1, **more), bundle_sample(bundle, 2, **more))  # type: ignore[arg-type]


def differing(first: Bundle | None, second: Bundle | None) -> dict[str, tuple[str, str]]:
    return differing_fields(of(first), of(second))


def test_what_follows_from_another_field_is_no_difference() -> None:
    seven = bundle_of("7 B1")
    assert differing(seven, seven) == {}
    assert differing(seven, bundle_of("7 B2")) == {"wire": ("B1", "B2")}
    assert differing(seven, bundle_of("12 B1")) == {"number": ("7", "12")}
    assert differing(seven, bundle_of("7 B1", tape="none", taping="none")) == {
        "taping": ("half-lap", "none")
    }
    assert differing(seven, bundle_of("7 B1", tape="PET")) == {"tape": ("PVC", "PET")}
    tube = bundle_of("7 B1", conduit="twist-tube", conduit_bore=0.01)
    assert differing(seven, tube) == {"conduit": ("none", "twist-tube")}
    wider = bundle_of("7 B1", conduit="twist-tube", conduit_bore=0.012)
    assert differing(tube, wider) == {"conduit_bore": ("10 mm", "12 mm")}
    assert differing(seven, bundle_of("7 B1", arrangement="symmetric")) == {}


def test_the_type_counts_where_there_is_no_bundle() -> None:
    tube = of(None)
    assert "type" in differing_fields(tube, of(bundle_of("7 B1")))
    other = group(bundle_sample(None, 3, spool="other"))
    assert differing_fields(tube, other) == {}
    assert differing_fields(tube, other, by=("spool",)) == {"spool": ("tube-s1", "other")}


def test_dimensions_differ_by_more_than_a_percent() -> None:
    first = of(None, dimensions={"length": 0.1})
    assert differing_fields(first, of(None, dimensions={"length": 0.1005})) == {}
    longer = of(None, dimensions={"length": 0.12})
    assert differing_fields(first, longer) == {"length": ("100 mm", "120 mm")}
    assert differing_fields(first, of(None, dimensions={})) == {"length": ("100 mm", "not said")}


def test_tests_of_one_name_are_both_kept() -> None:
    one, two = samples()[:2]
    group = built([replace(one, source="a/result.h5"), replace(two, test=one.test, source="b")])
    assert list(group.numbers[0].values) == ["s1-1 (a/result.h5)", "s1-1 (b)"]


def test_notes_of_groups(approved: Approve) -> None:
    """What is reported of groups whose samples, curves or numbers need a word."""
    usual, doubted = samples(), samples()
    slip = (Reason("slip", "0.5 N at 3 mm"),)
    doubtful = stiffness(60.0, status=Status.DOUBTFUL, reasons=slip)
    doubted[0] = replace(doubted[0], results=(doubtful,))
    one, two, three = usual[:3]
    longer = replace(two, specimen=replace(two.specimen, dimensions={"length": 0.4}))
    (curve,) = one.loading
    force = curve.force.copy()
    force[40:44] = np.nan
    gap = replace(one, loading=(SampleCurve(curve.displacement, force, force),))
    far = SampleCurve(curve.displacement + 0.05, curve.force, curve.force)
    groups = {
        "two spools": usual,
        "a doubtful value": doubted,
        "none": [],
        "one sample": [one],
        "two samples": [one, two],
        "tested twice": [one, replace(one, test="again")],
        "other size": [one, longer],
        "without a curve": [one, two, replace(three, loading=())],
        "a gap": [gap, two, three],
        "no overlap": [one, replace(two, loading=(far,))],
    }
    lines = []
    for name, members in groups.items():
        group = built(members)
        lines += [name, *(f"  {code}: {message}" for code, message in said(group).items())]
        lines.append(f"  band: {group.band.reason or 'whole'}")
    wires = (("7 B1", "24 h"), ("12 B1", "48 h"), ("12 B1", "48 h"))
    bundles = [
        bundle_sample(bundle_of(words), at, labels={"cured": cured})
        for at, (words, cured) in enumerate(wires, start=1)
    ]
    slips = [build_sample("s1", "a", slips=2), build_sample("s1", "b", slips=1)]
    marked = tuple(replace(slip, decision=SlipDecision.MARKED) for slip in slips[1].slips)
    notes = [
        *sample_notes(bundles),
        *sample_notes([bundles[0], bundle_sample(None, 2)]),
        *method_notes({}, [slips[0], replace(slips[1], slips=marked)]),
        *grouping_notes(["taping"], ["s1"]),
    ]
    approved([*lines, *(f"{note.severity} {note.code}: {note.message}" for note in notes)])


def test_decisions_on_pooling(approved: Approve) -> None:
    near, far = [1.1, 2.1, 2.9, 4.2], [11.1, 12.1, 12.9, 14.2]
    spools: list[dict[str, list[float]]] = [
        {},
        {"a": [1.0]},
        {"a": [1.0, 2.0, 4.0]},
        {"a": [1.0], "b": [2.0], "c": [4.0]},
        {"a": [1.0, 1.0], "b": [1.0, 1.0]},
        {"a": [1.0], "b": [1.0]},
        {"a": [1.0, 2.0, 3.0], "b": [1.1, 2.1, 2.9]},
        {"a": [1.0, 2.0, 3.0, 4.0], "b": near},
        {"a": [1.0, 2.0, 3.0, 4.0], "b": far},
    ]
    means = [nested_mean(spool) for spool in spools]
    approved(f"{mean.decision} [{mean.chosen.reason or 'interval'}]" for mean in means)


SHORT, LONG = "line from 2 mm to 8 mm", "line from 1 mm to 14 mm"


def result(name: str, method: str, made_of: str = "") -> Result:
    why = (Reason("no_noise", "none"),)
    return Result(name, 1.0, "N/m", reasons=why, method=method, made_of=made_of)


def number(name: str, methods: Mapping[str, str]) -> GroupNumber:
    values = {test: result(name, method) for test, method in methods.items()}
    return GroupNumber(name, "N/m", None, values, {})


def samples_of(*methods: str, **more: Result) -> list[Sample]:
    """Samples a, b, c ... with a stiffness by these methods, and more results that are alike."""
    made = [
        (name, (result("stiffness", method), *more.values()))
        for name, method in zip("abc", methods, strict=False)
    ]
    return [replace(build_sample("s1", name), test=name, results=own) for name, own in made]


def test_what_was_made_over_another_window_is_not_in_the_mean() -> None:
    samples = samples_of(SHORT, LONG, SHORT)
    left_out = otherwise_made(samples)
    why = Reason("made_otherwise", f"made by {LONG}; the mean: {SHORT}")
    assert left_out == {"stiffness": {"b": why}}
    (note,) = method_notes(left_out, samples)
    assert (note.code, note.severity, note.where) == (
        "protocols_differ", Severity.WARNING, "stiffness"
    )  # fmt: skip
    assert note.message == f"not in the mean, as it was made otherwise: b ({why.message})"
    (stiffness,) = build_group("A", "p", samples).numbers
    assert list(stiffness.values) == ["a", "c"]
    assert stiffness.left_out == {"b": (why,)}


def test_the_way_of_the_first_test_counts_where_two_are_as_frequent() -> None:
    assert list(otherwise_made(samples_of(LONG, SHORT))["stiffness"]) == ["b"]


def marked(sample: Sample) -> Sample:
    slips = tuple(replace(slip, decision=SlipDecision.MARKED) for slip in sample.slips)
    return replace(sample, slips=slips)


FORCE = "scale of the force"


def measured(value: float, **changes: float) -> Result:
    names = {"noise": "noise", "force": FORCE, "pull": "pull offset"}
    budget = tuple(
        Contribution(names[key], change, is_common=key == "force")
        for key, change in changes.items()
    )
    return Result("k", value, "N/m", budget=budget)


def budgeted(*results: Result) -> GroupNumber:
    values = {f"T{place}": result for place, result in enumerate(results)}
    mean = with_shared(
        nested_mean({"s1": [result.value or 0.0 for result in results]}), {"s1": list(results)}
    )
    return GroupNumber("k", "N/m", mean, values, {})


def test_medians_are_scaled_to_one_and_a_missing_cause_is_none() -> None:
    """Shares of noise 1, 0.8, 0.9 and of the force 0, 0.2, 0.1: 0.9 and 0.1; of one alone, none."""
    found = group_budget(
        budgeted(
            measured(1.0, noise=1.0),
            measured(2.0, noise=2.0, force=1.0),
            measured(3.0, noise=3.0, force=1.0),
            measured(9.0),
        )
    )
    assert found.of_tests == pytest.approx({"noise": 0.9, FORCE: 0.1})
    once = budgeted(*(measured(1.0, noise=1.0, pull=by) for by in (0.0, 0.0, 1.0)))
    assert group_budget(once).of_tests == {"noise": 1.0}


def test_the_mean_is_made_of_scatter_and_what_is_common() -> None:
    """1 and 3: half width 12.706; a common change of 3 adds 5.880: (5.880 / 14.001)^2 = 0.1764."""
    found = group_budget(budgeted(measured(1.0, noise=1.0, force=3.0), measured(3.0, force=3.0)))
    assert list(found.of_mean) == [SCATTER, FORCE]
    assert found.of_mean[FORCE] == pytest.approx(0.17637, abs=1e-5)
    assert sum(found.of_mean.values()) == pytest.approx(1.0)


def test_nothing_to_tell() -> None:
    alone = group_budget(budgeted(measured(1.0)))
    assert (alone.of_tests, alone.of_mean) == ({}, {})
    none = GroupNumber("k", "N/m", None, {}, {})
    assert group_budget(none).of_mean == {}
    assert group_budget(budgeted(measured(2.0), measured(2.0))).of_mean == {}


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("number", ["7", "12", "19"]),
        ("taping", ["none", "coarse", "half-lap"]),
        ("conduit", ["none", "corrugated-tube", "twist-tube-5", "twist-tube-10"]),
        ("cured", ["not said", "2 h", "24 h"]),
    ],
)
def test_words_have_an_order(name: str, words: list[str]) -> None:
    assert sorted(sorted(words), key=lambda word: field_order(name, word)) == words
