"""Groups of samples, their names, differences between them, and settings that differ."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.campaign.reporting import (
    OTHER_FAMILY,
    QUESTION_FAMILY,
    GroupKey,
    check_fields,
    describe_differing_settings,
    divide_into_groups,
    find_differences,
    list_settings,
    name_groups,
    note_differing_settings,
    rename_shared_spools,
)
from labpipe.errors import UsageError
from labpipe.protocol.load import find_protocol, format_protocol, load_protocol, parse_protocol
from labpipe.protocol.schema import Groups, Protocol
from labpipe.records.group import Verdict
from tests.builders.bundle_campaigns import (
    MAIN,
    PROTOCOL,
    bundle_campaign,
    bundle_of,
    bundle_sample,
    conduit_cases,
    grouped,
    three_of,
)

SEVEN = bundle_sample(bundle_of("7 B1"), 1, spool="s1", labels={"cured": "24 h"})
TWELVE = bundle_sample(bundle_of("12 B1"), 2, spool="s1")
TUBE = bundle_sample(None, 3, spool="s2")


def test_group_keys_and_names() -> None:
    keys = list(divide_into_groups([SEVEN, TWELVE, TUBE], ("wire", "cured")))
    assert list(name_groups(keys).values()) == [
        "without wire, without cured",
        "wire B1, without cured",
        "wire B1, cured 24 h",
    ]
    assert [key.missing_fields for key in keys[1:]] == [["cured"], []]
    for field, values in (("number", ["", "7", "12"]), ("type", ["tube-10", "tube-5"])):
        shuffled = [GroupKey(((field, value),), "p") for value in reversed(values)]
        assert [x.fields[0][1] for x in sorted(shuffled, key=lambda key: key.rank)] == values
    assert keys[1].rank < keys[1]._replace(fields=(*keys[1].fields, ("length", "85 mm"))).rank
    keys_of_one_name = [keys[1], keys[1]._replace(protocol="other")]
    assert [*name_groups(keys_of_one_name).values()] == [
        f"wire B1, without cured, {key.protocol}" for key in keys_of_one_name
    ]


def test_unknown_field_is_refused_with_the_nearest() -> None:
    with pytest.raises(UsageError) as raised:
        check_fields(["wire", "tapping"], [SEVEN, TUBE], "--by")
    assert str(raised.value) == (
        "--by: expected fields of these test sheets: type, spool, wire, number,"
        " composition, arrangement, tape, taping, conduit, cured, length, found 'tapping'."
        " Nearest: taping."
    )
    check_fields(["cured", "length"], [SEVEN, TUBE], "--by")


def test_spools_shared_by_types_are_renamed() -> None:
    samples, renamed = rename_shared_spools([SEVEN, TWELVE, TUBE])
    assert renamed == ["s1"]
    assert [sample.specimen.spool for sample in samples] == [
        f"{SEVEN.specimen.type} s1", f"{TWELVE.specimen.type} s1", "s2",
    ]  # fmt: skip
    same_spool = replace(SEVEN, test="other")
    samples, renamed = rename_shared_spools([SEVEN, same_spool])
    assert ([sample.specimen for sample in samples], renamed) == ([SEVEN.specimen] * 2, [])


def test_lengths_divide_a_type_unless_fields_are_chosen() -> None:
    sizes = [{"length": 0.085}, {"length": 0.1}, {"length": 0.085}]
    samples = [bundle_sample(None, number, dimensions=group) for number, group in enumerate(sizes)]
    groups = divide_into_groups(samples)
    assert list(name_groups(list(groups)).values()) == ["tube, 85 mm", "tube, 100 mm"]
    assert [[x.specimen.sample for x in group] for group in groups.values()] == [["0", "2"], ["1"]]
    assert list(divide_into_groups(samples, ["type"])) == [
        GroupKey((("type", "tube"),), "taped-bundle")
    ]


NONE = bundle_of("19 B2", conduit="corrugated-tube", tape="none", taping="none")
HALF_LAP = bundle_of("19 B2", conduit="corrugated-tube")


def test_differences_of_a_single_field_come_first_in_rising_order() -> None:
    differences = bundle_campaign(conduit_cases()).differences
    fields = [item.single_field for item in differences]
    assert list(dict.fromkeys(fields)) == ["wire", "number", "taping", "conduit", ""]
    assert {item.family for item in differences if not item.single_field} == {""}
    assert {item.verdict for item in differences if not item.single_field} == {Verdict.NOT_ASKED}
    questions = [item for item in differences if item.family == QUESTION_FAMILY]
    assert {item.name for item in questions} == {MAIN[0]}
    assert {item.name for item in differences if item.family == OTHER_FAMILY} == {MAIN[1]}
    assert {item.n_comparisons for item in questions} == {len(questions)}
    assert fields == sorted(fields, key=list(dict.fromkeys(fields)).index)
    taping = [item.fields["taping"] for item in differences if item.single_field == "taping"]
    assert set(taping) == {("none", "coarse"), ("none", "half-lap"), ("coarse", "half-lap")}
    (number,) = {item.fields["number"] for item in differences if item.single_field == "number"}
    assert number == ("12", "19")
    assert all(item.difference.mean > 0 for item in differences if item.single_field == "number")


def test_half_lap_against_none_that_are_equal_within_two_percent() -> None:
    """Truly 1.5 % apart, scatter 1 %, margin 10 %: equivalent, and said with numbers."""
    for seed in range(5):
        samples = [
            *three_of(NONE, seed=seed),
            *(bundle_sample(HALF_LAP, number, scale=1.015, seed=seed) for number in (1, 2, 3)),
        ]
        (stiffness, _) = bundle_campaign(samples).differences
        assert stiffness.fields == {"taping": ("none", "half-lap")}
        assert stiffness.verdict is Verdict.EQUIVALENT
        assert "within 10 %: p = " in stiffness.verdict_reason
        assert stiffness.p_equivalent < 0.05


def test_twenty_percent_apart_is_different() -> None:
    samples = [*three_of(NONE), *three_of(HALF_LAP, scale=1.2)]
    (stiffness, _) = bundle_campaign(samples).differences
    assert stiffness.verdict is Verdict.DIFFERENT
    assert stiffness.difference.interval is not None
    truth = 0.2 * 19 * 1.4e-3
    assert stiffness.difference.interval.lower < truth < stiffness.difference.interval.upper


def test_difference_states_differing_settings() -> None:
    samples = [*three_of(NONE), *three_of(HALF_LAP)]
    settings = {sample.test: {"results.kink.to": "5 mm"} for sample in samples}
    settings[samples[0].test] = {"results.kink.to": "4 mm"}
    wishes = {PROTOCOL: Groups(main=MAIN)}
    differences, _ = find_differences(grouped(samples), wishes, settings, ("type",))
    message = "the tests were processed with different settings: results.kink.to differ"
    assert message in differences[0].caveats


@pytest.fixture(scope="module")
def tube() -> Protocol:
    path = find_protocol("twist-tube", sheet_folder=Path())
    assert isinstance(path, Path)
    return load_protocol(path)


def changed(protocol: Protocol, old: str, new: str) -> Protocol:
    text = format_protocol(protocol)
    assert old in text
    return parse_protocol(text.replace(old, new, 1), "synthetic")


def test_note_on_a_differing_setting(tube: Protocol) -> None:
    settings = dict(list_settings(tube))
    changed_settings = list_settings(changed(tube, "force_below: 50 %", "force_below: 20 %"))
    (note,) = note_differing_settings({"a": settings, "b": settings, "c": changed_settings})
    assert (note.code, note.where) == ("protocols_differ", "curve.failure.force_below")
    assert note.message == "different settings among the tests: 20 % (c) and 50 % (a, b)"
    assert describe_differing_settings({"a": settings, "c": changed_settings}) == (
        "the tests were processed with different settings: curve.failure.force_below differ",
    )
    assert not describe_differing_settings({"a": settings, "b": settings})
    bare = list_settings(tube.model_copy(update={"steps": (), "results": (), "branches": None}))
    assert describe_differing_settings({"a": settings, "b": bare}) == (
        "the tests were processed with different settings: steps, branches, results differ",
    )
