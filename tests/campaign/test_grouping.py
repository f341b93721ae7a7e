from __future__ import annotations

from dataclasses import replace

import pytest

from labpipe.campaign.grouping import (
    Key,
    check_fields,
    division,
    group_names,
    in_turn,
    key_of,
    with_own_spools,
    without,
)
from labpipe.errors import UsageError
from tests.builders.bundle_campaigns import bundle_of, bundle_sample, grouped

SEVEN = bundle_sample(bundle_of("7 B1"), 1, spool="s1", labels={"cured": "24 h"})
TWELVE = bundle_sample(bundle_of("12 B1"), 2, spool="s1")
TUBE = bundle_sample(None, 3, spool="s2")


def test_keys_and_names() -> None:
    by = ("wire", "cured")
    keys = [key_of(sample, by) for sample in (SEVEN, TWELVE, TUBE)]
    assert keys == [
        Key(("B1", "24 h"), "taped-bundle"),
        Key(("B1", ""), "taped-bundle"),
        Key(("", ""), "taped-bundle"),
    ]
    assert list(group_names(keys, by).values()) == [
        "wire B1, cured 24 h",
        "wire B1, without cured",
        "without wire, without cured",
    ]
    assert without(keys[1], by) == ["cured"]
    assert without(keys[0], by) == []


def test_two_protocols_stand_in_the_name() -> None:
    keys = [Key(("A2",), "one"), Key(("A2",), "two"), Key(("A3",), "two")]
    assert list(group_names(keys, ("type",)).values()) == ["A2, one", "A2, two", "A3"]


def test_order_of_groups() -> None:
    counts = [Key((word,), "p") for word in ("12", "", "7")]
    assert [key.words[0] for key in in_turn(counts, ("number",))] == ["", "7", "12"]
    types = [Key((word,), "p") for word in ("tube-5", "tube-10")]
    assert [key.words[0] for key in in_turn(types, ("type",))] == ["tube-10", "tube-5"]


def test_an_unknown_field_is_told_with_the_nearest() -> None:
    with pytest.raises(UsageError) as told:
        check_fields(["wire", "tapping"], [SEVEN, TUBE], "--by")
    assert str(told.value) == (
        "--by: expected fields of these test sheets, which are type, spool, wire, number,"
        " composition, arrangement, tape, taping, conduit, cured, length, found 'tapping'."
        " Write taping, or another of them."
    )
    check_fields(["cured", "length"], [SEVEN, TUBE], "--by")


def test_spools_of_one_name_belong_to_their_types() -> None:
    samples, renamed = with_own_spools([SEVEN, TWELVE, TUBE])
    assert renamed == ["s1"]
    assert [sample.specimen.spool for sample in samples] == [
        f"{SEVEN.specimen.type} s1", f"{TWELVE.specimen.type} s1", "s2",
    ]  # fmt: skip
    again = replace(SEVEN, test="other")
    assert with_own_spools([SEVEN, again]) == ([SEVEN, again], [])


def test_groups_without_a_field_are_groups_too() -> None:
    assert [group.name for group in grouped([SEVEN, TUBE], "wire")] == ["without wire", "wire B1"]


def test_lengths_of_one_type_are_two_groups_unless_asked_otherwise() -> None:
    sizes = [{"length": 0.085}, {"length": 0.1}, {"length": 0.085}]
    samples = [bundle_sample(None, at, dimensions=own) for at, own in enumerate(sizes)]
    found = division(samples)
    assert list(group_names(list(found), ["type"]).values()) == ["tube, 85 mm", "tube, 100 mm"]
    assert [[each.specimen.sample for each in own] for own in found.values()] == [["0", "2"], ["1"]]
    assert list(division(samples, ["type"])) == [Key(("tube",), "taped-bundle")]


def test_a_protocol_is_named_once_where_a_type_is_divided() -> None:
    length = (("length", "85 mm"),), (("length", "100 mm"),)
    keys = [Key(("A2",), name, more) for name in ("one", "two") for more in length]
    assert list(group_names(keys, ["type"]).values()) == [
        "A2, one, 85 mm", "A2, one, 100 mm", "A2, two, 85 mm", "A2, two, 100 mm",
    ]  # fmt: skip
    assert list(group_names(keys[:2], ["type"]).values()) == ["A2, 85 mm", "A2, 100 mm"]
