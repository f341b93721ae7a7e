"""Groups are divided by all of the specimen that differs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from labpipe.records.group import Sample
from labpipe.statistics.group_division import Part, divide
from tests.builders.bundle_campaigns import bundle_of, bundle_sample


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


def said(parts: Sequence[Part]) -> list[tuple[Mapping[str, str], list[str]]]:
    return [(part.fields, [each.test for each in part.samples]) for part in parts]


def test_two_lengths_are_two_parts() -> None:
    assert said(divide(wires(85, 100, 85, 100.4))) == [
        ({"length": "85 mm"}, ["t0", "t2"]),
        ({"length": "100.2 mm"}, ["t1", "t3"]),
    ]


def test_one_length_is_one_part_without_a_name() -> None:
    assert said(divide(wires(85, 85.4))) == [({}, ["t0", "t1"])]
    assert divide([]) == []


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
    assert said(divide(aged)) == [({"aged": "0 h"}, ["t0", "t2"]), ({"aged": "500 h"}, ["t1"])]
    assert len(divide(wires(85, 85, 85, serial=["a", "b", "c"]))) == 1


def test_what_says_the_same_again_is_not_named() -> None:
    parts = divide(wires(85, 85, 100, 100, rig=["short", "short", "long", "long"]))
    assert [part.fields for part in parts] == [{"length": "85 mm"}, {"length": "100 mm"}]


def test_bundles_of_one_type_are_divided_by_what_they_are_made_of() -> None:
    bundles = ["7 B1", "12 B1", "12 B1"]
    tapings = ["none", "none", "half-lap"]
    samples = [
        bundle_sample(
            bundle_of(wires, taping=taping, tape="none" if taping == "none" else "PVC"), at
        )
        for at, (wires, taping) in enumerate(zip(bundles, tapings, strict=True))
    ]
    assert [part.fields for part in divide(samples)] == [
        {"composition": "7 B1", "taping": "none"},
        {"composition": "12 B1", "taping": "none"},
        {"composition": "12 B1", "taping": "half-lap"},
    ]


def test_the_arrangement_of_wires_of_one_kind_is_none() -> None:
    samples = [
        bundle_sample(bundle_of("7 B1", arrangement=word), at)
        for at, word in enumerate(["packed", "asymmetric"])
    ]
    assert len(divide(samples)) == 1
    mixed = [
        bundle_sample(bundle_of("4 B1 + 3 B2", arrangement=word), at)
        for at, word in enumerate(["symmetric", "asymmetric"])
    ]
    assert [part.fields for part in divide(mixed)] == [
        {"arrangement": "symmetric"}, {"arrangement": "asymmetric"}
    ]  # fmt: skip
