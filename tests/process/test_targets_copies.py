from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.process.targets import find_copies, recording_of
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.result import InputFile, Specimen, TestResult

RESULT = TestResult(
    test="T-1",
    specimen=Specimen("tube", "1", "1"),
    protocol="p",
    protocol_yaml="",
    test_yaml="",
    labpipe_version="",
    inputs=(InputFile("frame", "a.csv", "12", 1), InputFile("markers", "b.csv", "34", 1)),
    recordings={},
    aligned=None,
    curve=None,
    shape=None,
    results=(),
    quality=(),
)
SOURCES = """
version: 1
name: p
sources:
  frame:
    reader: load-frame
    part: Specimen 1
    channels: {force: {channel: F}, displacement: {channel: D}}
  markers: {reader: motive-csv}
markers: {clamp: Base, along: [wire 1]}
"""


def protocol(old: str = "", new: str = "") -> Protocol:
    return parse_protocol(SOURCES.replace(old, new), "p.yaml")


def test_names_of_test_and_files_do_not_matter() -> None:
    turned = tuple(replace(each, file="c.csv") for each in reversed(RESULT.inputs))
    other = replace(RESULT, test="T-2", specimen=Specimen("hose", "2", "2"), inputs=turned)
    assert recording_of(RESULT, protocol()) == recording_of(other, protocol())


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("Specimen 1", "Specimen 2"),
        ("channel: F", "channel: F2"),
        ("wire 1", "w 2"),
        ("Base", "B2"),
    ],
)
def test_one_export_may_hold_several_specimens(old: str, new: str) -> None:
    assert recording_of(RESULT, protocol()) != recording_of(RESULT, protocol(old, new))


def test_other_bytes_are_another_recording() -> None:
    first, second = RESULT.inputs
    changed = replace(RESULT, inputs=(first, replace(second, sha256="56")))
    assert recording_of(RESULT, protocol()) != recording_of(changed, protocol())


def test_all_but_the_first_are_copies() -> None:
    files = [Path(name) / "result.h5" for name in "abcd"]
    found = find_copies(list(zip(files, (1, 2, 1, 1), strict=True)))
    assert list(found) == [str(files[2]), str(files[3])]
    assert f"found the same exports, byte for byte, as in {files[0]}." in found[str(files[3])]
