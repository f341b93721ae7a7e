from __future__ import annotations

import re
from dataclasses import fields

import pytest

from labpipe.protocol.outline import RESULTS, result_names
from labpipe.results import KINDS
from labpipe.results.kinds import Kind


def _tag(entry: type[Kind]) -> str:
    return entry.result


@pytest.mark.parametrize("entry", KINDS, ids=_tag)
def test_every_result_says_what_it_is_called(entry: type[Kind]) -> None:
    names = result_names(_tag(entry), {"of": "stiffness"})

    assert names
    told = str(entry.__doc__)
    for name in names:
        stem = re.sub(r"\.\d$", "", name)
        assert (
            stem in told
            or "name" in [each.name for each in fields(entry)]
            or "_per_peak_force" in told
        )


def test_no_two_results_share_a_tag_or_a_name() -> None:
    tags = [_tag(entry) for entry in KINDS]
    assert tags == list(RESULTS)
    # Both make a bending stiffness; a protocol that asks for both gives one of them another name.
    alike = [tag for tag in tags if tag != "bending-stiffness"]
    names = [name for tag in alike for name in result_names(tag, {"of": "stiffness"})]

    assert len(tags) == len(set(tags))
    assert len(names) == len(set(names))


@pytest.mark.parametrize(
    ("tag", "entry", "names"),
    [
        ("stiffness", {}, ("stiffness",)),
        ("stiffness", {"name": "stiffness_second"}, ("stiffness_second",)),
        ("modulus", {"name": "modulus_annulus"}, ("modulus_annulus",)),
        ("normalised-stiffness", {"of": "break"}, ("break_per_peak_force",)),
        ("moment-curvature", {}, ("bending_stiffness",)),
        ("moment-curvature", {"name": "bending_stiffness_at_2"}, ("bending_stiffness_at_2",)),
        ("bending-stiffness", {"of": "initial_stiffness"}, ("bending_stiffness",)),
        ("bending-stiffness", {"of": "k", "name": "of_a_beam"}, ("of_a_beam",)),
        ("plateau", {}, ("end_slope", "plateau_displacement", "plateau_force")),
        ("hardening", {}, ("hardening.2",)),
        ("failure", {"name": "ignored"}, ("failure_displacement", "failure_force")),
        ("peak-force", {}, ("peak_force.1",)),
        ("no-such-result", {}, ()),
    ],
)
def test_names_in_the_summary(tag: str, entry: dict[str, object], names: tuple[str, ...]) -> None:
    assert result_names(tag, entry) == names
