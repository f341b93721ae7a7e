"""Means over numbers that were not made alike are warned of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from labpipe.records.curve import SlipDecision
from labpipe.records.group import GroupNumber, Sample
from labpipe.records.quality import Reason, Severity
from labpipe.records.result import Result
from labpipe.statistics.group_notes import apart, method_notes, mixed, parted, ways_of
from tests.builders.campaigns import build_sample

SHORT, LONG = "line from 2 mm to 8 mm", "line from 1 mm to 14 mm"


def number(name: str, methods: Mapping[str, str], made_of: str = "") -> GroupNumber:
    values = {
        test: Result(
            name, 1.0, "N/m", reasons=(Reason("no_noise", "none"),), method=method, made_of=made_of
        )
        for test, method in methods.items()
    }
    return GroupNumber(name, "N/m", None, values, {})


def test_a_mean_over_two_windows_is_warned_of() -> None:
    stiffness = number("stiffness", {"a": SHORT, "b": LONG, "c": SHORT})
    (note,) = method_notes([stiffness], [])
    assert (note.code, note.severity, note.where) == (
        "protocols_differ", Severity.WARNING, "stiffness"
    )  # fmt: skip
    assert note.message == f"the mean mixes numbers made in 2 ways: {LONG} (b) and {SHORT} (a, c)"


def test_numbers_made_alike_are_not_warned_of() -> None:
    alike = number("stiffness", {"a": SHORT, "b": SHORT})
    assert not method_notes([alike], [build_sample("s1", "a", slips=2)])
    assert not apart(alike, alike)


def test_force_added_back_is_another_one_in_each_test() -> None:
    peaks = number("peak_force.1", dict.fromkeys("abc", "vertex"))
    added = {"a": "3.1 N of slips added back", "b": "0.4 N of slips added back", "c": ""}
    values = {test: replace(peaks.values[test], remark=words) for test, words in added.items()}
    assert ways_of(replace(peaks, values=values)) == {"vertex": ["a", "b", "c"]}


def test_what_is_made_of_a_mixed_number_is_mixed() -> None:
    modulus = number("modulus", dict.fromkeys("ab", "stiffness x length / area"), "stiffness")
    energy = number("energy", dict.fromkeys("ab", "area below the curve"))
    found = mixed([modulus, energy, number("stiffness", {"a": SHORT, "b": LONG})])
    assert found == {name: {SHORT: ["a"], LONG: ["b"]} for name in ("stiffness", "modulus")}


def marked(sample: Sample) -> Sample:
    slips = tuple(replace(slip, decision=SlipDecision.MARKED) for slip in sample.slips)
    return replace(sample, slips=slips)


def test_slips_that_were_treated_otherwise() -> None:
    one, two = build_sample("s1", "a", slips=2), marked(build_sample("s1", "b", slips=1))
    (note,) = method_notes([], [one, two])
    assert note.message == (
        "the mean mixes curves whose slips were treated otherwise: "
        "repaired (tt-s1a) and marked (tt-s1b)"
    )


def test_groups_that_are_compared() -> None:
    one, two = number("stiffness", {"a": SHORT}), number("stiffness", {"b": LONG})
    assert apart(one, two) == (f"not made alike: {SHORT} against {LONG}",)


def test_many_tests_are_counted() -> None:
    assert parted({"2 mm": list("abcde"), "": ["f"]}) == "not said (f) and 2 mm (the other 5)"
