"""Numbers that were not made alike are not averaged with each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from labpipe.records.curve import SlipDecision
from labpipe.records.group import GroupNumber, Sample
from labpipe.records.quality import Reason, Severity
from labpipe.records.result import Result
from labpipe.statistics.group_notes import (
    apart,
    method_notes,
    mixed,
    otherwise_made,
    parted,
    ways_of,
)
from labpipe.statistics.groups import build_group
from tests.builders.campaigns import build_sample

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


def test_numbers_made_alike_are_not_warned_of() -> None:
    alike = number("stiffness", {"a": SHORT, "b": SHORT})
    assert not otherwise_made(samples_of(SHORT, SHORT))
    assert not method_notes({}, [build_sample("s1", "a", slips=2)])
    assert not apart(alike, alike)


def test_force_added_back_is_another_one_in_each_test() -> None:
    peaks = number("peak_force.1", dict.fromkeys("abc", "vertex"))
    added = {"a": "3.1 N of slips added back", "b": "0.4 N of slips added back", "c": ""}
    values = {test: replace(peaks.values[test], remark=words) for test, words in added.items()}
    assert ways_of(replace(peaks, values=values)) == {"vertex": ["a", "b", "c"]}


def test_what_is_made_of_a_number_goes_with_it() -> None:
    modulus = result("modulus", "stiffness x length / area", "stiffness")
    samples = samples_of(SHORT, LONG, SHORT, modulus=modulus, energy=result("energy", "area"))
    assert mixed(samples) == {
        name: {SHORT: ["a", "c"], LONG: ["b"]} for name in ("stiffness", "modulus")
    }
    assert list(otherwise_made(samples)["modulus"]) == ["b"]


def marked(sample: Sample) -> Sample:
    slips = tuple(replace(slip, decision=SlipDecision.MARKED) for slip in sample.slips)
    return replace(sample, slips=slips)


def test_slips_that_were_treated_otherwise() -> None:
    one, two = build_sample("s1", "a", slips=2), marked(build_sample("s1", "b", slips=1))
    (note,) = method_notes({}, [one, two])
    assert note.message == (
        "the mean mixes curves whose slips were treated otherwise: "
        "repaired (tt-s1a) and marked (tt-s1b)"
    )


def test_groups_that_are_compared() -> None:
    one, two = number("stiffness", {"a": SHORT}), number("stiffness", {"b": LONG})
    assert apart(one, two) == (f"not made alike: {SHORT} against {LONG}",)


def test_many_tests_are_counted() -> None:
    assert parted({"2 mm": list("abcde"), "": ["f"]}) == "not said (f) and 2 mm (the other 5)"
