"""Groups: how samples are divided, what enters and is left out, notes, budgets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from labpipe.records.curve import SlipDecision
from labpipe.records.group import Group, GroupNumber, Sample, SampleCurve, Verdict
from labpipe.records.harness_bundle import Bundle
from labpipe.records.quality import Reason, Severity, join_reasons
from labpipe.records.result import Contribution, Result, Status
from labpipe.statistics.group_samples import (
    Subset,
    describe_values,
    divide_samples,
    find_differing_fields,
    find_other_methods,
    make_field_sort_key,
    make_grouping_notes,
    make_method_notes,
    make_sample_notes,
)
from labpipe.statistics.groups import build_group, compare_groups
from labpipe.statistics.means import (
    SCATTER,
    add_common_causes,
    compute_nested_mean,
    summarise_budget,
)
from labpipe.statistics.significance import judge_family
from tests.approved import Approve
from tests.builders.bundle_campaigns import bundle_of, bundle_sample
from tests.builders.campaigns import build_sample, built, make, said, samples, stiffness


def test_numbers_and_band_of_two_spools() -> None:
    group = built(samples())
    number = group.numbers[0]
    assert (number.name, number.unit, len(number.values)) == ("stiffness", "N/m", 6)
    assert number.mean is not None
    assert number.mean.chosen.mean == pytest.approx(52.28)
    assert not number.exclusions
    assert (group.band.n, group.band.members) == (2, "spool means")
    np.testing.assert_allclose(group.band.mean, 52.28 * group.band.displacement)
    assert "not pooled over 6 samples" in said(group)["curve_pooling"]
    assert group.scaled_band is None
    reverse = built(samples()[::-1])
    assert [sample.test for sample in reverse.samples] == [sample.test for sample in group.samples]
    assert reverse.numbers == group.numbers
    one, two = samples()[:2]
    alike = built([replace(one, source="a/result.h5"), replace(two, test=one.test, source="b")])
    assert list(alike.numbers[0].values) == ["s1-1 (a/result.h5)", "s1-1 (b)"]


def test_what_is_left_out_says_why() -> None:
    reasons = (Reason("too_few_samples", "3 samples"),)
    results = [
        *((stiffness(None, status=Status.FAILED, reasons=reasons),), (stiffness(1.0, "N/mm"),)),
        *((), (stiffness(float("inf")),)),
    ]
    failed = [replace(make("s1", index, 50.0), results=own) for index, own in enumerate(results)]
    number = built([*failed, make("s2", 1, 50.0), make("s2", 2, 50.0)]).numbers[0]
    assert list(number.values) == ["s2-1", "s2-2"]
    assert {test: join_reasons(reasons) for test, reasons in number.exclusions.items()} == {
        "s1-0": "too_few_samples: 3 samples",
        "s1-1": "other_unit: in N/mm; most samples are in N/m",
        "s1-2": "no_result: the test has no stiffness",
        "s1-3": "not_finite: the value is inf",
    }


def test_groups_are_compared_in_what_both_have() -> None:
    first, second = built(samples()[:3]), built(samples()[3:])
    named = compare_groups(first, second, names=["stiffness", "energy"], margin=0.1)
    assert [difference.name for difference in named] == ["stiffness"]
    assert named[0].difference.mean == pytest.approx(47.12 - 57.44)
    assert named[0].margin == pytest.approx(5.744)
    assert named[0].verdict is Verdict.NOT_ASKED
    assert judge_family("one", named)[0].verdict is Verdict.DIFFERENT
    unnamed = compare_groups(first, second)
    assert [difference.name for difference in unnamed] == ["stiffness", "peak_force.1"]
    assert unnamed[0].margin is None
    assert np.isnan(unnamed[0].p_equivalent)


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


def divided(subsets: Sequence[Subset]) -> list[tuple[Mapping[str, str], list[str]]]:
    return [(subset.fields, [sample.test for sample in subset.samples]) for subset in subsets]


def test_two_lengths_are_two_parts() -> None:
    """Measured ones stay together: no two neighbours more than 5 % apart; none is another one."""
    assert divided(divide_samples(wires(85, 100, 85, 100.4))) == [
        ({"length": "85 mm"}, ["t0", "t2"]),
        ({"length": "100.2 mm"}, ["t1", "t3"]),
    ]
    assert [subset.fields["length"] for subset in divide_samples(wires(85, None))] == [
        "85 mm",
        "not stated",
    ]
    lengths = [(96, 104, 100), (96, 104), (100, 104.9), (100, 105.1), (20, 21)]
    assert [len(divide_samples(wires(*length))) for length in lengths] == [1, 2, 1, 2, 1]


def test_a_label_divides_unless_it_names_each_test() -> None:
    aged = wires(85, 85, 85, aged=["0 h", "500 h", "0 h"])
    assert divided(divide_samples(aged)) == [
        ({"aged": "0 h"}, ["t0", "t2"]),
        ({"aged": "500 h"}, ["t1"]),
    ]
    assert len(divide_samples(wires(85, 85, 85, serial=["a", "b", "c"]))) == 1


def test_up_to_four_of_the_most_are_named() -> None:
    assert describe_values({"b": list("stuv"), "": ["w"]}) == "not stated (w) and b (s, t, u, v)"
    five = describe_values({"b": list("stuvx"), "a": ["w"]})
    assert five == "a (w) and b (the other 5)"


def group(*samples: Sample) -> Group:
    return build_group("any", "taped-bundle", samples)


def of(bundle: Bundle | None, **settings: object) -> Group:
    return group(bundle_sample(bundle, 1, **settings), bundle_sample(bundle, 2, **settings))  # type: ignore[arg-type]


def test_what_follows_from_another_field_is_no_difference() -> None:
    seven = bundle_of("7 B1")
    tube = bundle_of("7 B1", conduit="twist-tube", conduit_bore=0.01)
    wider = bundle_of("7 B1", conduit="twist-tube", conduit_bore=0.012)
    taped = bundle_of("7 B1", tape="none", taping="none")
    for first, second, fields in (
        (seven, seven, {}),
        (seven, bundle_of("7 B1", arrangement="symmetric"), {}),
        (seven, bundle_of("7 B2"), {"wire": ("B1", "B2")}),
        (seven, bundle_of("12 B1"), {"number": ("7", "12")}),
        (seven, taped, {"taping": ("half-lap", "none")}),
        (seven, bundle_of("7 B1", tape="PET"), {"tape": ("PVC", "PET")}),
        (seven, tube, {"conduit": ("none", "twist-tube")}),
        (tube, wider, {"conduit_bore": ("10 mm", "12 mm")}),
    ):
        assert find_differing_fields(of(first), of(second)) == fields


def test_types_spools_and_dimensions_that_differ() -> None:
    """The type counts where there is no bundle; dimensions differ by more than a percent."""
    plain = of(None)
    assert "type" in find_differing_fields(plain, of(bundle_of("7 B1")))
    other = group(bundle_sample(None, 3, spool="other"))
    assert find_differing_fields(plain, other) == {}
    assert find_differing_fields(plain, other, ("spool",)) == {"spool": ("tube-s1", "other")}
    first = of(None, dimensions={"length": 0.1})
    lengths = ((0.1005, ""), (0.1012, "101.2 mm"), (0.12, "120 mm"), (None, "not stated"))
    for length, text in lengths:
        second = of(None, dimensions={"length": length} if length else {})
        expected = {"length": ("100 mm", text)} if text else {}
        assert find_differing_fields(first, second) == expected


def test_notes_of_groups(approved: Approve) -> None:
    """What is reported of groups whose samples, curves or numbers need a word."""
    plain_samples, doubtful_samples = samples(), samples()
    slip = (Reason("slip", "0.5 N at 3 mm"),)
    doubtful = stiffness(60.0, status=Status.DOUBTFUL, reasons=slip)
    doubtful_samples[0] = replace(doubtful_samples[0], results=(doubtful,))
    first, second, third = plain_samples[:3]
    longer = replace(second, specimen=replace(second.specimen, dimensions={"length": 0.4}))
    (curve,) = first.loading
    force = curve.force.copy()
    force[40:44] = np.nan
    gap = replace(first, loading=(SampleCurve(curve.displacement, force, force),))
    far = SampleCurve(curve.displacement + 0.05, curve.force, curve.force)
    groups = {
        "two spools": plain_samples,
        "a doubtful value": doubtful_samples,
        "none": [],
        "one sample": [first],
        "two samples": [first, second],
        "tested twice": [first, replace(first, test="again")],
        "other size": [first, longer],
        "without a curve": [first, second, replace(third, loading=())],
        "a gap": [gap, second, third],
        "no overlap": [first, replace(second, loading=(far,))],
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
        *make_sample_notes(bundles),
        *make_sample_notes([bundles[0], bundle_sample(None, 2)]),
        *make_method_notes({}, [slips[0], replace(slips[1], slips=marked)]),
        *make_grouping_notes(["taping"], ["s1"]),
    ]
    approved([*lines, *(f"{note.severity} {note.code}: {note.message}" for note in notes)])


def test_decisions_on_pooling(approved: Approve) -> None:
    similar, different = [1.1, 2.1, 2.9, 4.2], [11.1, 12.1, 12.9, 14.2]
    spools: list[dict[str, list[float]]] = [
        {},
        {"a": [1.0]},
        {"a": [1.0, 2.0, 4.0]},
        {"a": [1.0], "b": [2.0], "c": [4.0]},
        {"a": [1.0, 1.0], "b": [1.0, 1.0]},
        {"a": [1.0], "b": [1.0]},
        {"a": [1.0, 2.0, 3.0], "b": [1.1, 2.1, 2.9]},
        {"a": [1.0, 2.0, 3.0, 4.0], "b": similar},
        {"a": [1.0, 2.0, 3.0, 4.0], "b": different},
    ]
    means = [compute_nested_mean(spool) for spool in spools]
    approved(f"{mean.decision} [{mean.chosen.reason or 'interval'}]" for mean in means)


def test_what_was_made_over_another_window_is_not_in_the_mean() -> None:
    """Of two as frequent the way of the first test counts."""
    short, long = "line from 2 mm to 8 mm", "line from 1 mm to 14 mm"
    mixed = [
        replace(build_sample("s1", name), test=name, results=(Result("k", 1.0, "N", method=how),))
        for name, how in (("a", short), ("b", long), ("c", short))
    ]
    reason = Reason("made_otherwise", f"computed by {long}, the mean by {short}")
    assert find_other_methods(mixed) == {"k": {"b": reason}}
    assert list(find_other_methods(mixed[1:])["k"]) == ["c"]
    (note,) = make_method_notes(find_other_methods(mixed), mixed)
    assert (note.code, note.severity, note.where) == ("protocols_differ", Severity.WARNING, "k")
    assert note.message == f"not in the mean, since the method differs: b ({reason.message})"
    (number,) = build_group("A", "p", mixed).numbers
    assert (list(number.values), number.exclusions) == (["a", "c"], {"b": (reason,)})


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
    mean = add_common_causes(
        compute_nested_mean({"s1": [result.value or 0.0 for result in results]}),
        {"s1": list(results)},
    )
    return GroupNumber("k", "N/m", mean, values, {})


def test_medians_are_scaled_to_one_and_a_missing_cause_is_none() -> None:
    """Shares of noise 1, 0.8, 0.9 and of the force 0, 0.2, 0.1: 0.9 and 0.1; of one alone, none."""
    budget = summarise_budget(
        budgeted(
            measured(1.0, noise=1.0),
            measured(2.0, noise=2.0, force=1.0),
            measured(3.0, noise=3.0, force=1.0),
            measured(9.0),
        )
    )
    assert budget.test_shares == pytest.approx({"noise": 0.9, FORCE: 0.1})
    number = budgeted(*(measured(1.0, noise=1.0, pull=by) for by in (0.0, 0.0, 1.0)))
    assert summarise_budget(number).test_shares == {"noise": 1.0}
    empty = summarise_budget(budgeted(measured(1.0)))
    assert (empty.test_shares, empty.mean_shares) == ({}, {})
    assert summarise_budget(GroupNumber("k", "", compute_nested_mean({}), {}, {})).mean_shares == {}
    assert summarise_budget(budgeted(measured(2.0), measured(2.0))).mean_shares == {}


def test_the_mean_is_made_of_scatter_and_what_is_common() -> None:
    """1 and 3: half width 12.706; a common change of 3 adds 5.880: (5.880 / 14.001)^2 = 0.1764."""
    budget = summarise_budget(
        budgeted(measured(1.0, noise=1.0, force=3.0), measured(3.0, force=3.0))
    )
    assert list(budget.mean_shares) == [SCATTER, FORCE]
    assert budget.mean_shares[FORCE] == pytest.approx(0.17637, abs=1e-5)
    assert sum(budget.mean_shares.values()) == pytest.approx(1.0)


def test_words_have_an_order() -> None:
    for name, values in {
        "number": ["7", "12", "19"],
        "taping": ["none", "coarse", "half-lap"],
        "conduit": ["none", "corrugated-tube", "twist-tube-5", "twist-tube-10"],
        "cured": ["not stated", "2 h", "24 h"],
    }.items():
        assert sorted(sorted(values), key=partial(make_field_sort_key, name)) == values
