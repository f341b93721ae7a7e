from __future__ import annotations

import pytest

from labpipe.records.group import Group, Sample
from labpipe.records.harness_bundle import Bundle
from labpipe.statistics.group_fields import (
    differing_fields,
    fields_of,
    in_order,
    known_fields,
    shared_fields,
    varying_fields,
)
from labpipe.statistics.groups import build_group
from tests.builders.bundle_campaigns import bundle_of, bundle_sample


def group(*samples: Sample) -> Group:
    return build_group("any", "taped-bundle", samples)


def of(bundle: Bundle | None, **more: object) -> Group:
    return group(bundle_sample(bundle, 1, **more), bundle_sample(bundle, 2, **more))  # type: ignore[arg-type]


def differing(first: Bundle | None, second: Bundle | None) -> dict[str, tuple[str, str]]:
    return differing_fields(of(first), of(second))


def test_fields_of_a_bundle() -> None:
    sample = bundle_sample(
        bundle_of("7 B1", conduit="twist-tube", conduit_bore=0.0107), 1, labels={"cured": "24 h"}
    )
    assert fields_of(sample.specimen) | {"type": "", "spool": ""} == {
        "type": "", "spool": "", "wire": "B1", "number": "7", "composition": "7 B1",
        "arrangement": "packed", "tape": "PVC", "taping": "half-lap", "conduit": "twist-tube",
        "cured": "24 h", "length": "114.3 mm", "conduit_bore": "10.7 mm",
    }  # fmt: skip
    assert known_fields([sample.specimen])[:3] == ["type", "spool", "wire"]


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


def test_mixes_differ_in_composition_and_arrangement() -> None:
    """Of nine and ten wires of two kinds, wire and number are alike and the bundles are not."""
    symmetric = bundle_of("9 B1 + 10 B2", arrangement="symmetric")
    asymmetric = bundle_of("10 B1 + 9 B2", arrangement="asymmetric")
    assert differing(symmetric, asymmetric) == {
        "composition": ("9 B1 + 10 B2", "10 B1 + 9 B2"),
        "arrangement": ("symmetric", "asymmetric"),
    }


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


def test_dimensions_of_a_group_may_scatter() -> None:
    sizes = (0.1, 0.1008)
    samples = [
        bundle_sample(None, at, dimensions={"length": size}) for at, size in enumerate(sizes)
    ]
    assert shared_fields(samples)["length"] == "100.4 mm"
    apart = [*samples, bundle_sample(None, 3, dimensions={"length": 0.11})]
    assert "length" not in shared_fields(apart)
    assert varying_fields(group(*apart)) == ("length",)


def test_what_varies_within_a_group_is_no_difference() -> None:
    mixed = group(bundle_sample(bundle_of("7 B1"), 1), bundle_sample(bundle_of("12 B2"), 2))
    assert varying_fields(mixed) == ("type", "composition")
    assert differing_fields(mixed, of(bundle_of("7 B1", tape="PET"))) == {"tape": ("PVC", "PET")}
    assert shared_fields([]) == {}


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
    assert sorted(sorted(words), key=lambda word: in_order(name, word)) == words
