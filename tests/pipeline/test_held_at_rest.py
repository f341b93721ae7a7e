"""What is taken of a string at rest, and how it is said."""

from __future__ import annotations

from dataclasses import replace

import pytest

from labpipe.pipeline.held_at_rest import held, stated
from labpipe.pipeline.string_at_rest import AtRest
from labpipe.records.quality import Severity

TAUT = AtRest(ahead=0.0, sag=1e-5, reach=5e-3, weight=0.0265, lowest=-0.0084, error=1e-4)


def test_a_taut_string_carries_the_counterweight() -> None:
    found = held(TAUT)
    assert (found.state, found.tension, found.weight, found.other) == ("taut", 0.0265, 0.0265, None)
    note = found.note
    assert (note.code, note.severity, note.where) == (
        "string_at_rest",
        Severity.INFO,
        "rig.string",
    )
    assert note.message == (
        "the string was taut at rest and carried the counterweight of 26.5 mN: its tip stood 0.01 "
        "mm below the axis of the clamp, where the counterweight bends it by 5 mm; the clamp is 0 "
        "mm ahead of it when the string pulls; the lowest force is -8.4 mN against that at rest"
    )


def test_a_slack_string_leaves_it_to_the_wire() -> None:
    found = held(replace(TAUT, ahead=1.2e-3, sag=5.5e-3, lowest=0.0, slackened=-1e-5))
    assert (found.state, found.tension, found.weight, found.other) == ("slack", 0.0, 0.0265, None)
    assert found.why.startswith(
        "the string carried nothing at rest: the wire hung under the counterweight of 26.5 mN: "
    )
    assert found.why.endswith("later the string goes slack at -0.01 mN against the force at rest")


def test_a_counterweight_that_does_not_pull_at_the_wire() -> None:
    found = held(replace(TAUT, ahead=1.2e-3, lowest=0.0))
    assert (found.state, found.tension, found.weight, found.other) == ("off the wire", 0, 0, None)
    assert "yet the wire did not hang: the counterweight is taken not to pull at it" in found.why


def test_a_part_of_it_is_taken_as_measured() -> None:
    found = held(replace(TAUT, sag=2.5e-3, slackened=-0.013))
    assert (found.state, found.tension, found.weight) == ("part", 0.013, 0.0265)
    assert found.other == pytest.approx(0.013 - 1e-4 * 3**0.5)
    assert found.why.startswith("the string carried 13 mN of the counterweight of 26.5 mN at rest:")


@pytest.mark.parametrize(("ahead", "taken", "other"), [(0.0, 0.0265, 0.0), (1e-3, 0.0, 0.0265)])
def test_what_the_test_does_not_tell_is_in_the_intervals(
    ahead: float, taken: float, other: float
) -> None:
    found = held(replace(TAUT, ahead=ahead, sag=1.6e-3, lowest=0.0))
    assert (found.state, found.tension, found.other) == ("unknown", taken, other)
    assert found.note.severity is Severity.WARNING
    assert found.why.startswith("it is not known whether the string carried the counterweight of ")
    assert found.why.endswith(
        ". If you know, write 'rig.string.at_rest: {value: taut, because: ...}' under 'overrides' "
        "in test.yaml, or slack"
    )


def test_it_can_be_stated() -> None:
    assert stated("taut", 0.0265).tension == 0.0265
    found = stated("slack", 0.0265)
    assert (found.tension, found.weight, found.other) == (0.0, 0.0265, None)
    assert found.why == (
        "the string was slack at rest and carried nothing: so rig.string.at_rest states it"
    )
