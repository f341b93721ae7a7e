"""What protocols hold, where they are found, and how they are written and read again."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from labpipe.errors import Fault, ProtocolError
from labpipe.protocol.load import (
    find_protocol,
    find_shipped_folder,
    format_protocol,
    list_protocol_folders,
    list_protocols,
    parse_protocol,
)
from labpipe.protocol.schema import (
    AlignNone,
    AlignTurningPoints,
    Failure,
    MachineCompliance,
    Slips,
    list_result_names,
)
from labpipe.records.declarations import Smooth, Span
from tests.protocol.conftest import TUBE, WIRE


def test_protocols_hold_si(wire: str, tube: str) -> None:
    protocol = parse_protocol(wire, "p.yaml")
    assert protocol.specimen.length == 0.085
    assert protocol.rig.string is not None
    assert protocol.rig.string.counterweight == 0.0027
    assert isinstance(protocol.align, AlignTurningPoints)
    assert protocol.align.max_drift == 500e-6
    for written, meant in {"A": ("A",), "[A, B*]": ("A", "B*"), "all": "all"}.items():
        markers = parse_protocol(wire.replace("along: all", f"along: {written}"), "p").markers
        assert markers is not None
        assert markers.along == meant
    smooth = protocol.steps[-1]
    assert isinstance(smooth, Smooth)
    assert smooth.span == Span("time", 0.1)

    protocol = parse_protocol(tube, "p.yaml")
    curve, groups = protocol.curve, protocol.groups
    assert curve is not None
    assert curve.compliance == MachineCompliance(value="0.2 um/N", uncertainty="5 %")
    assert curve.compliance.value == 0.2e-6
    assert curve.failure == Failure(force_below="50 %")
    assert curve.slips == Slips(decision="marked", min_drop="2 N")
    assert curve.slack is not None
    assert (curve.slack.start, curve.slack.stop) == (0.1, 0.3)
    assert groups.main == ("stiffness_first", "peak_force.2")
    assert (groups.scaled, groups.min_p, groups.margin) == (True, 0.01, 0.1)


ONE = "{reader: dspace-mat, channel: a, unit: mN}"
VOLTS = "calibration: {gain: -210.82 mN/V, offset: 2.846 mN, gain_uncertainty: 1 %}"
PEAK = (
    "{reader: dspace-mat, channel: [a, b], unit: mV, scale_uncertainty: 0.4 %, calibration:"
    " {gain: 1 N/V, gain_uncertainty: 0.3 %}, plausible_peak: {from: 500 mN, to: 2 kN}}"
)


@pytest.mark.parametrize(
    ("source", "channels", "unit", "numbers", "peak"),
    [
        (ONE, ("a",), "N", (1.0, 0.0, 0.0), None),
        (
            "{reader: dspace-mat, channels: {force: {channel: a, unit: mN}}}",
            *(("a",), "N", (1.0, 0.0, 0.0), None),
        ),
        (ONE.replace("mN", f"V, {VOLTS}"), ("a",), "V", (-0.21082, 0.002846, 0.01), None),
        (ONE.replace("mN", f"mV, {VOLTS}"), ("a",), "V", (-0.21082, 0.002846, 0.01), None),
        ("{reader: dspace-mf4, channel: a}", ("a",), None, (1.0, 0.0, 0.0), None),
        (PEAK, ("a", "b"), "V", (1.0, 0.0, 0.005), (0.5, 2000.0)),
    ],
    ids=["short", "long", "volts", "millivolts", "unit of the export", "peak"],
)
def test_a_channel_of_a_source(
    source: str,
    channels: tuple[str, ...],
    unit: str | None,
    numbers: tuple[float, ...],
    peak: tuple[float, float] | None,
) -> None:
    """A gain is SI per SI whatever the unit; beside the source, everything has a default."""
    text = f"version: 1\nname: p\nsources: {{force: {source}}}\n"
    protocol = parse_protocol(text, "p.yaml")
    channel = protocol.channels["force"]
    assert (channel.channel, channel.target_unit, channel.channel_unit) == (channels, "N", unit)
    assert (channel.gain, channel.offset) == numbers[:2]
    assert channel.gain_uncertainty == pytest.approx(numbers[2], rel=1e-12)
    assert channel.peak_range == peak
    assert protocol.align == AlignNone()
    assert (protocol.steps, protocol.curve, protocol.results) == ((), None, ())


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


@settings(max_examples=20)
@given(place=st.sampled_from([(text, path) for text, path in BLOCKS if path]), is_key=st.booleans())
def test_a_block_with_an_unknown_key_or_that_is_a_word_is_refused(
    place: tuple[str, tuple[Any, ...]], is_key: bool
) -> None:
    text, path = place
    data = yaml.safe_load(text)
    *blocks, last = (*path, "keyxxx") if is_key else path
    node = data
    for part in blocks:
        node = node[part]
    node[last] = "word"
    with pytest.raises(ProtocolError) as info:
        parse_protocol(yaml.safe_dump(data), "p.yaml")
    dotted = ".".join(map(str, (*blocks, last)))
    expected = "one of the keys " if is_key else "a block of keys with values, found 'word'"
    assert f"({dotted}): expected {expected}" in str(info.value)
    assert not is_key or "found 'keyxxx'." in str(info.value)


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


def _quantity(unit: str, least: float, most: float) -> st.SearchStrategy[str]:
    return st.floats(least, most, allow_subnormal=False).map(lambda number: f"{number!r} {unit}")


_WORD = st.text(min_size=1)
_WORDS = st.lists(_WORD, min_size=1, max_size=3)
_SPAN = st.one_of(
    *(_quantity(unit, 1e-6, 1e6) for unit in ("s", "mm")),
    _quantity("%", 0.01, 100.0),
    st.integers(1, 10**6).map(lambda number: f"{number} samples"),
)


@st.composite
def _protocols(draw: st.DrawFn) -> dict[str, Any]:
    data: dict[str, Any] = yaml.safe_load(WIRE)
    data["about"] = draw(st.text(max_size=30))
    wall, area = draw(_quantity("m", 1e-6, 0.05)), draw(_quantity("mm^2", 1e-4, 1e5))
    length = draw(_quantity("m", 1e-3, 10.0))
    data["specimen"] = {"length": length, "section": {"wall": wall, "area": area}}
    data["rig"] = {"string": {"length": length}, "cycles": draw(st.integers(1, 99))}
    data["markers"] |= {
        "clamp": draw(_WORD),
        "along": draw(st.one_of(st.just("all"), _WORDS)),
        "centre_offset": draw(_quantity("mm", -1e3, 1e3)),
    }
    data["align"]["max_drift"] = draw(_quantity("ppm", 0.0, 1e6))
    data["steps"][-1]["span"] = draw(_SPAN)
    data["sources"]["force"]["channel"] = draw(_WORD)
    return data


@st.composite
def _tensile_protocols(draw: st.DrawFn) -> dict[str, Any]:
    data: dict[str, Any] = yaml.safe_load(TUBE)
    low, high = draw(st.floats(0.1, 49.0)), draw(st.floats(50.0, 100.0))
    data["sources"]["frame"] |= {"dialect": draw(_WORDS), "part": draw(_WORD)}
    data["sources"]["frame"]["channels"]["force"] |= {
        "channel": draw(st.one_of(_WORD, _WORDS)),
        "scale_uncertainty": draw(_quantity("%", 0.0, 100.0)),
        "zero_drift": draw(_quantity("%", 0.0, 100.0)),
        "plausible_peak": {"from": f"{low!r} mN", "to": f"{high!r} N"},
    }
    decision = draw(st.sampled_from(["marked", "repaired", "cut"]))
    data["curve"] |= {
        "compliance": {"value": draw(_quantity("um/N", 1e-6, 1e6))},
        "slips": {"decision": decision, "min_drop": f"{low!r} mN"},
        "slack": {"from": f"{low!r} %", "to": f"{high!r} %"},
    }
    data["results"][-1] |= {"from": f"{low!r} N", "to": f"{high!r} N"}
    data["groups"] = {"margin": f"{low!r} %", "scaled": draw(st.booleans())}
    return data


@settings(max_examples=16)
@given(st.one_of(_protocols(), _tensile_protocols()))
def test_a_protocol_written_reads_back_equal(data: dict[str, Any]) -> None:
    protocol = parse_protocol(yaml.safe_dump(data, allow_unicode=True), "p.yaml")
    dumped = format_protocol(protocol)
    again = parse_protocol(dumped, "result.h5")
    assert again == protocol
    assert format_protocol(again) == dumped


def test_folders_of_protocols(
    tmp_path: Path, repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That of the lab first, or of the working folder; those that labpipe brings last."""
    lab_folder = tmp_path / "protocols"
    lab_folder.mkdir()
    (lab_folder / "wire-cantilever.yml").write_text("", encoding="utf-8")
    (lab_folder / "notes.txt").write_text("", encoding="utf-8")
    assert list_protocol_folders(lab_folder) == (lab_folder, repository / "protocols")
    protocols = list_protocols(lab_folder)
    assert protocols["wire-cantilever"] == lab_folder / "wire-cantilever.yml"
    assert protocols["markers-only"] == repository / "protocols" / "markers-only.yaml"
    assert "notes" not in protocols
    monkeypatch.chdir(tmp_path)
    assert list_protocol_folders()[0] == Path("protocols")
    installed = tmp_path / "labpipe" / "shipped" / "protocols"
    installed.mkdir(parents=True)
    module = tmp_path / "labpipe" / "protocol" / "load.py"
    monkeypatch.setattr("labpipe.protocol.load.__file__", str(module))
    assert list_protocol_folders(tmp_path / "lab") == (installed,)
    assert find_shipped_folder("examples") == tmp_path / "examples", "as in a checkout"


def test_a_path_is_sought_beside_the_sheet_and_then_from_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sheet_folder = tmp_path / "raw" / "test"
    sheet_folder.mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "raw" / "own.yaml").write_text("", encoding="utf-8")

    assert find_protocol("../own.yaml", sheet_folder=sheet_folder) == sheet_folder / "../own.yaml"
    assert find_protocol("raw/own.yaml", sheet_folder=sheet_folder) == Path("raw/own.yaml")
    missing = find_protocol("no/own.yaml", sheet_folder=sheet_folder)
    assert isinstance(missing, Fault)
    assert (missing.path, missing.found) == (("protocol",), "'no/own.yaml'")
    assert str(sheet_folder / "no/own.yaml") in missing.remedy


@pytest.mark.parametrize(
    ("tag", "entry", "names"),
    [
        ("stiffness", {"name": "stiffness_second"}, ("stiffness_second",)),
        ("normalised-stiffness", {"of": "break"}, ("break_per_peak_force",)),
        ("moment-curvature", {}, ("bending_stiffness",)),
        ("bending-stiffness", {"of": "k", "name": "of_a_beam"}, ("of_a_beam",)),
        ("plateau", {}, ("end_slope", "plateau_displacement", "plateau_force")),
        ("hardening", {}, ("hardening.2",)),
        ("failure", {"name": "ignored"}, ("failure_displacement", "failure_force")),
        ("peak-force", {}, ("peak_force.1",)),
        ("no-such-result", {}, ()),
    ],
)
def test_names_in_the_summary(tag: str, entry: dict[str, object], names: tuple[str, ...]) -> None:
    assert list_result_names(tag, entry) == names
