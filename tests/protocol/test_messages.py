"""What is refused in protocols, test sheets, plans and harness files: each message once."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from labpipe.errors import ProtocolError
from labpipe.protocol.grammar import FileStem, SingleLine, Text, build_pydantic_type
from labpipe.protocol.load import (
    load_calibration_plan,
    load_campaign_plan,
    load_harness,
    parse_protocol,
    validate_document,
)
from labpipe.protocol.sheet_grammar import TestSheet
from labpipe.protocol.yaml_text import parse_yaml
from labpipe.records.declarations import (
    Compliance,
    Force,
    Fraction,
    Length,
    Mass,
    Offset,
    Ratio,
    SnakeName,
    Span,
)
from tests.approved import Approve
from tests.protocol.conftest import SHEET, TUBE, WIRE, Tell
from tests.protocol.test_harness_file import BETWEEN_CLIPS, WHOLE
from tests.protocol.test_plans import BY_NAME

Change = tuple[str, str]


def faults(name: str) -> list[str]:
    """Cases of one kind in ``faults.txt``, a line each."""
    text = (Path(__file__).parent / "faults.txt").read_text(encoding="utf-8")
    _, _, cases = text.partition(f"## {name}\n")
    return cases.partition("\n\n")[0].strip("\n").split("\n")


def describe_changes(case: str) -> list[Change]:
    """The changes, old => new, of a case."""
    pairs = [pair.partition(" =>") for pair in case.replace("\\n", "\n").split(" && ")]
    return [(old, new.removeprefix(" ")) for old, _, new in pairs]


CALIBRATION_PLAN = """\
version: 1
parameters:
  insulation_modulus: {}
comparisons:
  - {name: fe, file: fe.csv, wire: A2, length: 85 mm, because: a model of solid elements}
"""
VALUE_FAULTS: list[tuple[Any, tuple[object, ...]]] = [
    (Text, (True, "")),
    (FileStem, ("a/b", "nul.1")),
    (SingleLine, ("A\x072", "\ud800", "A2\n")),
    (SnakeName, ("Force",)),
    (Length, ("53", "53 s", "85 kg", "85 MM", "20 1/m", "0 mm", "-5 mm", None)),
    (Length, ("12,5 mm", "-0,125 mm", "1,000 mm", "1 000 mm", "1'000 mm")),
    (Length, ("1.000,5 mm", "1,000.5 mm", "1 000 000,25 mm", "8,5 kg", "8,5e-3 m", "1,5,5 mm")),
    (Force, ("5 kg", "500 g")),
    (Mass, ("-1 g", "5 N")),
    (Offset, ("1e400 mm",)),
    (Ratio, ("5 deg", "0,5", "0,5 %", "8,5 deg")),
    (Fraction, ("0 %", "110 %")),
    (Compliance, ("0.2 mm",)),
    (Span, ("51", "0 samples", "120 %", "0 s", "0,1 s", "0,1 mm", "1 kg", "5,5 %", "1.5 samples")),
]


YAML_FAULTS = [
    "a: 1\nb: 2\na: 3\n",
    "a: !!python/object/new:os.system [ls]\n",
    "{[a, b]: 8,5}\n",
]


NO_YAML = [
    "a: [1, 2\nb: 3\n",
    "a: 1\n  b: 2\n",
    "a: 1\n\tb: 2\n",
    "a: &x 1\nb: *x\n",
    "a: 1\n---\nb: 2\n",
    "a: 1\nb: \x00\n",
    "[" * 5000,
    "[" * 16 + "1" + "]" * 16,
]


def changed(text: str, changes: Iterable[Change]) -> str:
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


def refused(written: str, read: Callable[..., object], *given: Any) -> str:
    """What was written, on one line, and the message below it."""
    with pytest.raises((ProtocolError, ValidationError)) as error:
        read(*given)
    if isinstance(error.value, ValidationError):
        lines = [
            error["msg"].removeprefix("Value error, ").strip() for error in error.value.errors()
        ]
    else:
        lines = str(error.value).splitlines()
    return "\n    ".join([repr(written)[1:-1], *(line.replace(os.sep, "/") for line in lines)])


CONDUIT = Path(__file__).parents[2] / "protocols" / "conduit-bundle.yaml"


@pytest.mark.parametrize(
    ("name", "protocol"),
    [("wire", WIRE), ("tube", TUBE), ("conduit", CONDUIT.read_text("utf-8"))],
    ids=["wire", "tube", "conduit"],
)
def test_protocols(name: str, protocol: str, approved: Approve) -> None:
    approved(
        refused(
            "; ".join(new or f"no {old}" for old, new in describe_changes(case)),
            parse_protocol,
            changed(protocol, describe_changes(case)),
            "p.yaml",
        )
        for case in faults(name)
    )


def test_overrides(lab: Path, tell: Tell, approved: Approve) -> None:
    """A protocol that is wrong itself is not blamed on the test."""
    written = {line: f"{SHEET}overrides:\n  {line}\n" for line in faults("overrides")}
    written |= {
        case: changed(SHEET, describe_changes(case)) for case in faults("tests of a protocol")
    }
    texts = [
        "\n    ".join([line, *(message.replace(os.sep, "/") for message in tell(text))])
        for line, text in written.items()
    ]
    wrong = WIRE.replace("cycles: 3", "cycles: x")
    (lab / "protocols" / "wire.yaml").write_text(wrong, encoding="utf-8")
    approved([*texts, *(message.replace(os.sep, "/") for message in tell(SHEET))])


BUNDLE = """\
test: b1
protocol: taped-bundle
specimen:
  type: TWB
  spool: s1
  sample: 1
  bundle:
    {}
files: {{force: force.mat}}
"""


PLAIN = """\
test: A2-085-1
protocol: wire
specimen: {type: A2, spool: A2-s1, sample: 01, length: 80 mm, width: 2 mm}
files: {force: force.mat}
"""


def test_sheets(approved: Approve) -> None:
    sheets = {text: BUNDLE.format(text.replace("\\n", "\n    ")) for text in faults("bundles")}
    sheets |= {case: changed(PLAIN, describe_changes(case)) for case in faults("sheet")}
    approved(refused(new, _sheet, text) for new, text in sheets.items())


def _sheet(text: str) -> object:
    return validate_document(TestSheet, parse_yaml(text, "x"))


def test_values(approved: Approve) -> None:
    approved(
        refused(str(text), _parse, kind, text) for kind, texts in VALUE_FAULTS for text in texts
    )


def _parse(kind: Any, text: object) -> object:
    return TypeAdapter(build_pydantic_type(kind)).validate_python(text)


def test_yaml(approved: Approve) -> None:
    messages = [fault for text in YAML_FAULTS for *_, fault in parse_yaml(text, "x").faults]
    assert len(messages) == len(YAML_FAULTS)
    approved(
        [
            *messages,
            *(refused(text[:40], parse_yaml, text, "x") for text in NO_YAML),
        ]
    )


@pytest.mark.parametrize(
    ("name", "load", "text"),
    [
        ("campaign", load_campaign_plan, BY_NAME),
        ("calibration", load_calibration_plan, CALIBRATION_PLAN),
        ("harness", load_harness, WHOLE),
        ("reach", load_harness, BETWEEN_CLIPS),
    ],
    ids=["campaign", "calibration", "harness", "reach"],
)
def test_plans(
    name: str,
    load: Callable[[Path], object],
    text: str,
    tmp_path: Path,
    approved: Approve,
) -> None:
    path, messages = tmp_path / "plan.yaml", []
    for case in faults(name):
        path.write_text(changed(text, describe_changes(case)), encoding="utf-8")
        messages.append(refused(case, load, path))
    approved(message.replace(f"{tmp_path.as_posix()}/", "") for message in messages)
