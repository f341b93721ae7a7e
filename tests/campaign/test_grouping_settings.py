"""Tests of one protocol that were processed otherwise are told apart."""

from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.campaign.grouping import setting_notes, settings_of, unlike_words
from labpipe.protocol.load import dump_protocol, find_protocol, load_protocol, parse_protocol
from labpipe.protocol.schema import Protocol


@pytest.fixture(scope="module")
def tube() -> Protocol:
    path = find_protocol("twist-tube", beside=Path())
    assert isinstance(path, Path)
    return load_protocol(path)


def changed(protocol: Protocol, old: str, new: str) -> Protocol:
    text = dump_protocol(protocol)
    assert old in text
    return parse_protocol(text.replace(old, new, 1), "synthetic")


def test_windows_go_by_the_name_of_their_result(tube: Protocol) -> None:
    found = settings_of(tube)
    assert found["results.stiffness_first.from"] == "2 mm"
    assert found["steps"].startswith("zero, zero 2")
    assert not any(key.startswith(("sources", "specimen", "report", "groups")) for key in found)


def test_a_setting_that_differs_is_told_at_its_key(tube: Protocol) -> None:
    own = dict(settings_of(tube))
    other = settings_of(changed(tube, "force_below: 50 %", "force_below: 20 %"))
    (note,) = setting_notes({"a": own, "b": own, "c": other})
    assert (note.code, note.where) == ("protocols_differ", "curve.failure.force_below")
    assert note.message == "set otherwise from test to test: 20 % (c) and 50 % (a, b)"
    assert unlike_words({"a": own, "c": other}) == (
        "the tests were processed otherwise: curve.failure.force_below differ",
    )
    assert not unlike_words({"a": own, "b": own})
    bare = settings_of(tube.model_copy(update={"steps": (), "results": (), "branches": None}))
    assert unlike_words({"a": own, "b": bare}) == (
        "the tests were processed otherwise: steps, branches, results differ",
    )


def test_what_is_told_of_a_result_is_not_told_again(tube: Protocol) -> None:
    other = settings_of(changed(tube, "from: 2 mm", "from: 1 mm"))
    settings = {"a": settings_of(tube), "b": other}
    assert [note.where for note in setting_notes(settings)] == ["results.stiffness_first.from"]
    assert not setting_notes(settings, ["stiffness_first"])


def test_a_result_that_is_missing_is_told_once(tube: Protocol) -> None:
    less = tube.model_copy(update={"results": tube.results[:-1]})
    found = setting_notes({"a": settings_of(tube), "b": settings_of(less)})
    assert [note.where for note in found] == ["results"]


def test_a_block_that_differs_in_many_settings_is_told_once(tube: Protocol) -> None:
    """A conduit bundle without the frame's export has other steps and another way to align."""
    own = dict(settings_of(tube))
    less = {key: said for key, said in own.items() if not key.startswith("curve.")}
    other = less | {f"align.a{number}": "x" for number in range(5)}
    notes = setting_notes({"with": own | {f"align.a{k}": "y" for k in range(5)}, "without": other})
    (align,) = [note for note in notes if note.where == "align"]
    assert align.message == (
        "set otherwise from test to test: 5 settings, the first align.a0: y (with) and x (without)"
    )
    assert not [note for note in notes if note.where.startswith("align.")]
