from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from labpipe.errors import ProtocolError
from labpipe.protocol.load import (
    checked,
    dump_protocol,
    load_protocol,
    parse_protocol,
)
from labpipe.protocol.sheet_grammar import TestSheet
from labpipe.protocol.yaml_text import parse_yaml
from tests.protocol.conftest import SHEET, TUBE, WIRE, Tell


def _blocks(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Give the paths of all blocks of keys that are closed to unknown keys."""
    if isinstance(node, dict):
        if path not in {("report", "display"), ("sources",), ("sources", "frame", "channels")}:
            yield path
        for key, value in node.items():
            yield from _blocks(value, (*path, key))
    if isinstance(node, list):
        for number, value in enumerate(node):
            yield from _blocks(value, (*path, number))


BLOCKS = [(text, path) for text in (WIRE, TUBE) for path in _blocks(yaml.safe_load(text))]


@pytest.mark.slow
@given(place=st.sampled_from(BLOCKS), key=st.from_regex(r"[a-z]{1,12}x{3}", fullmatch=True))
def test_an_unknown_key_anywhere_is_refused_by_name(
    place: tuple[str, tuple[Any, ...]], key: str
) -> None:
    text, path = place
    data = yaml.safe_load(text)
    node = data
    for part in path:
        node = node[part]
    node[key] = "1"

    with pytest.raises(ProtocolError) as info:
        parse_protocol(yaml.safe_dump(data), "p.yaml")

    dotted = ".".join(map(str, (*path, key)))
    assert f"({dotted}): expected one of the keys " in str(info.value)
    assert f"found '{key}'. Did you mean '" in str(info.value)


@given(place=st.sampled_from([(text, path) for text, path in BLOCKS if path]))
def test_a_block_that_is_a_word_is_refused(place: tuple[str, tuple[Any, ...]]) -> None:
    text, path = place
    data = yaml.safe_load(text)
    node = data
    for part in path[:-1]:
        node = node[part]
    node[path[-1]] = "word"

    with pytest.raises(ProtocolError) as info:
        parse_protocol(yaml.safe_dump(data), "p.yaml")

    dotted = ".".join(map(str, path))
    assert f"({dotted}): expected a block of keys with values, found 'word'" in str(info.value)


def test_all_faults_come_at_once_in_the_order_of_the_file() -> None:
    text = """\
version: 1
nmae: p
sources:
  force: {reader: dspace-mat, channel: a, unit: mm, unit: N}
steps:
  - {step: smooth, channel: forse, method: moving-average, span: 3}
curve: {force: force, displacement: d}
report: {figures: [timelin]}
"""

    with pytest.raises(ProtocolError) as info:
        parse_protocol(text, "p.yaml")

    places = [line.split(": expected")[0] for line in str(info.value).splitlines()]
    assert places == [
        "p.yaml, line 1, column 1",
        "p.yaml, line 2, column 1 (nmae)",
        "p.yaml, line 4, column 49 (sources.force.unit)",
        "p.yaml, line 4, column 53 (sources.force.unit)",
        "p.yaml, line 6, column 29 (steps.0.channel)",
        "p.yaml, line 6, column 66 (steps.0.span)",
        "p.yaml, line 7, column 37 (curve.displacement)",
        "p.yaml, line 8, column 20 (report.figures.0)",
    ]


def test_a_repeated_key_alone_is_refused() -> None:
    with pytest.raises(ProtocolError, match="found 'name' again"):
        parse_protocol(WIRE + "name: wire\n", "p.yaml")


@pytest.mark.parametrize("text", ["", "# nothing\n", "- a\n", "word\n"])
def test_a_file_that_is_no_block_of_keys(text: str) -> None:
    with pytest.raises(ProtocolError, match=r"p\.yaml, line 1, column 1: expected a block of keys"):
        parse_protocol(text, "p.yaml")


def _length(unit: str = "mm", least: float = 1e-6, most: float = 1e6) -> st.SearchStrategy[str]:
    return st.floats(least, most, allow_subnormal=False).map(lambda number: f"{number!r} {unit}")


@st.composite
def _protocols(draw: st.DrawFn) -> dict[str, Any]:
    data: dict[str, Any] = yaml.safe_load(WIRE)
    data["about"] = draw(st.text(max_size=30))
    data["specimen"] = {
        "length": draw(_length("m", 1e-3, 10.0)),
        "section": {
            "wall": draw(_length("m", 1e-6, 0.05)),
            "area": draw(_length("mm^2", 1e-4, 1e5)),
        },
    }
    data["rig"] = {
        "string": {"length": draw(_length("m", 1e-3, 10.0))},
        "cycles": draw(st.integers(1, 99)),
    }
    data["markers"] |= {
        "clamp": draw(st.text(min_size=1, max_size=9)),
        "along": draw(st.one_of(st.just("all"), st.lists(st.text(min_size=1), min_size=1))),
        "centre_offset": draw(st.floats(-1e3, 1e3).map(lambda number: f"{number!r} mm")),
    }
    data["align"]["max_drift"] = draw(st.floats(0, 1e6).map(lambda number: f"{number!r} ppm"))
    span = st.one_of(
        _length("s"),
        _length(),
        st.floats(0.01, 100.0).map(lambda number: f"{number!r} %"),
        st.integers(1, 10**6).map(lambda number: f"{number} samples"),
    )
    data["steps"][-1]["span"] = draw(span)
    data["sources"]["force"]["channel"] = draw(st.text(min_size=1))
    return data


@settings(max_examples=15)
@given(_protocols())
def test_a_protocol_written_reads_back_equal(data: dict[str, Any]) -> None:
    text = yaml.safe_dump(data, allow_unicode=True)

    protocol = parse_protocol(text, "p.yaml")

    dumped = dump_protocol(protocol)
    assert parse_protocol(dumped, "result.h5") == protocol
    assert dump_protocol(parse_protocol(dumped, "result.h5")) == dumped


_WORDS = st.lists(st.text(min_size=1), min_size=1, max_size=3)


@st.composite
def _tensile_protocols(draw: st.DrawFn) -> dict[str, Any]:
    data: dict[str, Any] = yaml.safe_load(TUBE)
    data["sources"]["frame"] |= {"dialect": draw(_WORDS), "part": draw(st.text(min_size=1))}
    force = data["sources"]["frame"]["channels"]["force"]
    force["channel"] = draw(st.one_of(st.text(min_size=1), _WORDS))
    force["scale_uncertainty"] = draw(st.floats(0, 100).map(lambda number: f"{number!r} %"))
    least = draw(st.floats(0, 1e6))
    most = least + draw(st.floats(1e-3, 1e6))
    force["zero_drift"] = draw(st.floats(0, 100).map(lambda number: f"{number!r} %"))
    force["plausible_peak"] = {"from": f"{least!r} mN", "to": f"{most!r} N"}
    low = draw(st.floats(0.1, 49.0))
    high = draw(st.floats(50.0, 100.0))
    data["curve"] |= {
        "compliance": {"value": draw(_length("um/N"))},
        "slips": {"decision": draw(st.sampled_from(["marked", "repaired", "cut"])),
                  "min_drop": f"{least!r} mN"},
        "slack": {"from": f"{low!r} %", "to": f"{high!r} %"},
    }  # fmt: skip
    data["results"][-1] |= {"from": f"{low!r} N", "to": f"{high!r} N"}
    data["groups"] = {"margin": f"{low!r} %", "scaled": draw(st.booleans())}
    return data


@settings(max_examples=15)
@given(_tensile_protocols())
def test_a_tensile_protocol_written_reads_back_equal(data: dict[str, Any]) -> None:
    protocol = parse_protocol(yaml.safe_dump(data, allow_unicode=True), "p.yaml")

    dumped = dump_protocol(protocol)
    assert parse_protocol(dumped, "result.h5") == protocol
    assert dump_protocol(parse_protocol(dumped, "result.h5")) == dumped


def test_what_a_tensile_protocol_does_not_say_is_not_written(tube: str) -> None:
    curve = tube[tube.index("curve:") : tube.index("branches:")]
    short = tube.replace(curve, "curve: {force: force, displacement: displacement}\n")
    short = short[: short.index("results:")]

    dumped = dump_protocol(parse_protocol(short, "p.yaml"))

    assert not {"compliance", "failure", "slips", "slack", "null"} & set(
        dumped.replace(":", " ").split()
    )


def test_a_written_protocol_reads_as_a_person_writes(wire: str) -> None:
    text = dump_protocol(parse_protocol(wire, "p.yaml"))

    for line in ("length: 85 mm", "counterweight: 2.7 g", "max_drift: 0.05 %", "- step: smooth"):
        assert line in text
    assert "null" not in text
    assert text.index("- result: initial-stiffness") < text.index("from: 0.5 mm")


def test_no_clamp_is_said_again(wire: str) -> None:
    text = """\
version: 1
name: p
sources: {markers: {reader: motive-csv}}
markers: {clamp: null}
"""

    assert "clamp: null" in dump_protocol(parse_protocol(text, "p.yaml"))


def test_a_protocol_from_a_file(tmp_path: Path, wire: str) -> None:
    path = tmp_path / "wire.yaml"
    path.write_text(wire, encoding="utf-8")

    assert load_protocol(path) == parse_protocol(wire, "x")


def test_all_faults_of_a_test_come_at_once(tell: Tell) -> None:
    lines = tell(
        SHEET.replace("markers: [take.csv]", "frame: a.csv")
        + "overrides:\n  rig.cycles: {value: no, because: x}\n  steps.x: {value: 1, because: x}\n"
    )

    assert [line.split(": expected")[0] for line in lines] == [
        f"test{os.sep}test.yaml, line 5, column 8 (files)",
        f"test{os.sep}test.yaml, line 5, column 27 (files.frame)",
        f"test{os.sep}test.yaml, line 7, column 23 (rig.cycles)",
        f"test{os.sep}test.yaml, line 8, column 3 (overrides.steps.x)",
    ]
    assert "expected a file in the role 'markers', found none. Add it to 'files'." in lines[0]
    assert (
        "expected a role of the protocol: 'force', 'markers', found 'frame'. Did you mean 'force'?"
        in lines[1]
    )


def test_a_protocol_that_is_wrong_itself_is_not_blamed_on_the_test(
    lab: Path, tell: Tell, wire: str
) -> None:
    wrong = wire.replace("cycles: 3", "cycles: x")
    (lab / "protocols" / "wire.yaml").write_text(wrong, encoding="utf-8")

    lines = tell(SHEET)

    assert len(lines) == 1
    assert lines[0].endswith("(rig.cycles): expected a whole number from 1 to 1000000, found 'x'.")


def test_a_protocol_that_is_not_there(tell: Tell) -> None:
    (line,) = tell(SHEET.replace("protocol: wire", "protocol: wirre"))

    assert line.startswith(
        f"test{os.sep}test.yaml, line 2, column 11 (protocol): expected one of the protocols"
        " 'wire',"
    )
    assert line.endswith("found 'wirre'. Did you mean 'wire'?")


def test_a_test_sheet_from_a_result_file() -> None:
    sheet = checked(TestSheet, parse_yaml(SHEET, "result.h5"))

    assert sheet.specimen.sample == "01"
    assert sheet.files == {"force": ("force.mat",), "markers": ("take.csv",)}
