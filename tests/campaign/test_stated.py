"""What protocols state for groups."""

from __future__ import annotations

import pytest

from labpipe.campaign.stated import number_kinds, with_sizes
from labpipe.protocol.load import known_protocols, load_protocol
from labpipe.protocol.schema import Section, SpecimenBlock
from labpipe.records.result import Specimen


def test_sizes_of_the_protocol_belong_to_the_specimen_unless_its_sheet_says_them() -> None:
    section = Section.model_validate({"width": "18.8 mm", "area": "5 mm^2"})
    said = SpecimenBlock.model_validate({"length": "300 mm", "section": section})
    specimen = with_sizes(Specimen("tape", "s1", "1", {"length": 0.25}), said)
    assert specimen.dimensions == {"length": 0.25, "width": 0.0188}
    bare = Specimen("tape", "s1", "1")
    assert with_sizes(bare, SpecimenBlock()) == bare


@pytest.mark.parametrize(
    ("name", "signed", "is_set"),
    [
        ("conduit-bundle", {"clock_offset", "clock_drift", "end_slope"}, True),
        ("pet-tape", {"slack"}, False),
    ],
)
def test_numbers_that_the_rig_sets_and_that_can_be_negative(
    name: str, signed: set[str], is_set: bool
) -> None:
    found = number_kinds(load_protocol(known_protocols()[name]))
    assert found.signed == signed
    assert found.set_by_rig == ({"peak_displacement"} if is_set else set())
