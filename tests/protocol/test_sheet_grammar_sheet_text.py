from __future__ import annotations

from hypothesis import example, given
from hypothesis import strategies as st

from labpipe.protocol.load import checked
from labpipe.protocol.sheet_grammar import TestSheet, write_test_sheet
from labpipe.protocol.sheet_grammar import test_sheet_faults as sheet_faults
from labpipe.protocol.yaml_text import parse_yaml

DATA: dict[str, object] = {
    "test": "0333",
    "protocol": "wire",
    "specimen": {"type": "A2", "spool": "no", "sample": "01", "length": "80 mm"},
    "date": "2026-03-04",
    "operator": "lab",
    "files": {"force": "a.mat", "markers": ["b.csv", "c.csv"]},
}


def test_a_sheet_is_written_with_comments() -> None:
    assert (
        write_test_sheet(DATA)
        == """\
# One test: what was tested, and which exports belong to it.
test: '0333'
protocol: wire              # name of a protocol, or a path beside this file
specimen:                   # samples are cut from a spool, spools belong to a type
  type: A2
  spool: 'no'
  sample: '01'
  length: 80 mm
date: 2026-03-04
operator: lab
files:                      # role: file in this folder, or a list of the parts of one recording
  force: a.mat
  markers:
  - b.csv
  - c.csv
# overrides:                # values of the protocol that this test changes, and why
#   sources.force.channel: {value: Model Root/Load Cell/Out1, because: other cabling}
"""
    )


TEXTS = st.text(min_size=1, max_size=30)
LINES = st.text(st.characters(exclude_categories=("Cc", "Cs", "Zl", "Zp", "Cn")), min_size=1)


@example("a\nb", "0", "0")
@example("0", "0", "\x85")
@example("0", "#: '", "0")
@given(TEXTS, LINES, TEXTS)
def test_a_sheet_written_reads_back(protocol: str, sample: str, value: str) -> None:
    specimen = {"type": "A2", "spool": "s", "sample": sample}
    overrides = {"rig.cycles": {"value": value, "because": "x"}}
    data = DATA | {"protocol": protocol, "specimen": specimen, "overrides": overrides}

    sheet = checked(TestSheet, parse_yaml(write_test_sheet(data), "x"))

    assert (sheet.protocol, sheet.specimen.sample) == (protocol, sample)
    assert sheet.overrides["rig.cycles"].value == value


def test_what_is_wrong_is_found_before_writing() -> None:
    assert sheet_faults(DATA) == []
    (fault,) = sheet_faults(DATA | {"date": "yesterday"})
    assert (fault.path, fault.found) == (("date",), "'yesterday'")
