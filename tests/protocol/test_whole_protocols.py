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
    dump_protocol,
    find_protocol,
    known_protocols,
    parse_protocol,
    protocol_folders,
    shipped_folder,
)
from labpipe.protocol.outline import result_names
from labpipe.protocol.schema import (
    AlignNone,
    AlignTurningPoints,
    Failure,
    MachineCompliance,
    Protocol,
    Slips,
)
from labpipe.records.declarations import Smooth, Span
from tests.protocol.conftest import SHEET, TUBE, WIRE, Tell


def test_a_protocol_holds_si(wire: str) -> None:
    protocol = parse_protocol(wire, "p.yaml")

    assert protocol.specimen.length == 0.085
    assert protocol.rig.string is not None
    assert protocol.rig.string.counterweight == 0.0027
    assert isinstance(protocol.align, AlignTurningPoints)
    assert protocol.align.max_drift == 500e-6
    smooth = protocol.steps[-1]
    assert isinstance(smooth, Smooth)
    assert smooth.span == Span("time", 0.1)


def test_defaults_are_filled_in() -> None:
    text = "version: 1\nname: p\nsources: {force: {reader: dspace-mat, channel: a, unit: N}}\n"

    protocol = parse_protocol(text, "p.yaml")

    assert protocol.align == AlignNone()
    assert (protocol.steps, protocol.curve, protocol.results) == ((), None, ())
    assert protocol.sources["force"].reader == ("dspace-mat",)


def test_a_tensile_protocol_holds_si(tube: str) -> None:
    protocol = parse_protocol(tube, "p.yaml")

    assert protocol.curve is not None
    assert protocol.curve.compliance == MachineCompliance(value="0.2 um/N", uncertainty="5 %")
    assert protocol.curve.compliance.value == 0.2e-6
    assert protocol.curve.failure == Failure(force_below="50 %")
    assert protocol.curve.slips == Slips(decision="marked", min_drop="2 N")
    assert protocol.curve.slack is not None
    assert (protocol.curve.slack.start, protocol.curve.slack.stop) == (0.1, 0.3)
    assert protocol.groups.main == ("stiffness_first", "peak_force.2")
    assert (protocol.groups.scaled, protocol.groups.min_p, protocol.groups.margin) == (
        True,
        0.01,
        0.1,
    )


@pytest.mark.parametrize(
    ("said", "meant"), [("all", "all"), ("A", ("A",)), ("[A, B*]", ("A", "B*"))]
)
def test_the_markers_along_the_specimen(wire: str, said: str, meant: object) -> None:
    protocol = parse_protocol(wire.replace("along: all", f"along: {said}"), "p.yaml")

    assert protocol.markers is not None
    assert protocol.markers.along == meant


def _protocol(sources: str) -> Protocol:
    return parse_protocol(f"version: 1\nname: p\nsources: {sources}\n", "p.yaml")


def test_the_short_way_names_the_channel_like_the_role() -> None:
    short = _protocol("{force: {reader: dspace-mat, channel: a, unit: mN}}").channels["force"]
    long = _protocol(
        "{force: {reader: dspace-mat, channels: {force: {channel: a, unit: mN}}}}"
    ).channels["force"]

    for channel in (short, long):
        assert (channel.channel, channel.target_unit, channel.channel_unit) == (("a",), "N", "N")
        assert (channel.gain, channel.offset, channel.gain_uncertainty) == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("unit", ["V", "mV"])
def test_a_gain_is_si_per_si_whatever_the_unit_of_the_channel(unit: str) -> None:
    channel = _protocol(
        f"{{force: {{reader: dspace-mat, channel: a, unit: {unit},"
        " calibration: {gain: -210.82 mN/V, offset: 2.846 mN, gain_uncertainty: 1 %}}}"
    ).channels["force"]

    assert channel.channel_unit == "V"
    assert (channel.gain, channel.offset) == (-0.21082, 0.002846)
    assert channel.gain_uncertainty == 0.01


def test_a_channel_whose_unit_the_export_must_say() -> None:
    channel = _protocol("{force: {reader: dspace-mf4, channel: a}}").channels["force"]

    assert channel.channel_unit is None


def test_a_peak_in_the_short_way() -> None:
    channel = _protocol(
        "{force: {reader: dspace-mat, channel: [a, b], unit: mV, scale_uncertainty: 0.4 %,"
        " calibration: {gain: 1 N/V, gain_uncertainty: 0.3 %},"
        " plausible_peak: {from: 500 mN, to: 2 kN}}}"
    ).channels["force"]

    assert channel.channel == ("a", "b")
    assert channel.peak_range == (0.5, 2000.0)
    assert channel.gain_uncertainty == pytest.approx(0.005, rel=1e-12)


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


def test_a_protocol_that_is_wrong_itself_is_not_blamed_on_the_test(
    lab: Path, tell: Tell, wire: str
) -> None:
    wrong = wire.replace("cycles: 3", "cycles: x")
    (lab / "protocols" / "wire.yaml").write_text(wrong, encoding="utf-8")

    lines = tell(SHEET)

    assert len(lines) == 1
    assert lines[0].endswith("(rig.cycles): expected a whole number from 1 to 1000000, found 'x'.")


def test_the_folder_of_the_lab_comes_first(tmp_path: Path, repository: Path) -> None:
    own = tmp_path / "mine"
    own.mkdir()
    (own / "wire-cantilever.yml").write_text("", encoding="utf-8")
    (own / "notes.txt").write_text("", encoding="utf-8")

    assert protocol_folders(own)[0] == own
    known = known_protocols(own)
    assert known["wire-cantilever"] == own / "wire-cantilever.yml"
    assert known["markers-only"] == repository / "protocols" / "markers-only.yaml"
    assert "notes" not in known


def test_the_working_folder_is_the_lab_if_nobody_says_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "protocols").mkdir()
    monkeypatch.chdir(tmp_path)

    assert protocol_folders()[0] == Path("protocols")


def test_an_installed_labpipe_brings_its_protocols(
    tmp_path: Path, repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert protocol_folders(tmp_path)[-1] == repository / "protocols"
    installed = tmp_path / "labpipe" / "shipped" / "protocols"
    installed.mkdir(parents=True)
    module = tmp_path / "labpipe" / "protocol" / "load.py"
    monkeypatch.setattr("labpipe.protocol.load.__file__", str(module))

    assert protocol_folders(tmp_path / "lab") == (installed,)
    assert shipped_folder("examples") == tmp_path / "examples", "as in a checkout"


def test_a_path_is_sought_beside_the_sheet_and_then_from_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    beside = tmp_path / "raw" / "test"
    beside.mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "raw" / "own.yaml").write_text("", encoding="utf-8")

    assert find_protocol("../own.yaml", beside=beside) == beside / "../own.yaml"
    assert find_protocol("raw/own.yaml", beside=beside) == Path("raw/own.yaml")
    missing = find_protocol("no/own.yaml", beside=beside)
    assert missing == Fault(
        ("protocol",),
        "a protocol",
        "'no/own.yaml'",
        f"There is none at {beside / 'no/own.yaml'} or {Path('no/own.yaml')}.",
    )


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
