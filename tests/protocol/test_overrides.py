from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.load import dump_protocol, load_test_sheet, resolve
from labpipe.protocol.schema import AlignNone, AlignStated, Protocol
from labpipe.results.stiffness import ComplianceResult, LineStiffness
from tests.protocol.conftest import SHEET, Tell


def test_a_test_puts_its_own_values_into_its_protocol(
    lab: Path, write: Callable[[str], Path]
) -> None:
    path = write(
        SHEET
        + """\
overrides:
  sources.force.calibration.gain: {value: 0.0411 N/V, because: "another cell"}
  markers.centre_offset: {value: 1 mm, because: "flat markers"}
  steps.smooth.span: {value: 51 samples, because: "slow recorder"}
  steps.0.max_jump: {value: 9 mm, because: "fast"}
  rig.stroke: {value: 20 mm, because: "short"}
"""
    )

    protocol = resolve(load_test_sheet(path), path, lab / "protocols")

    assert protocol.specimen.length == 0.080
    assert protocol.channels["force"].gain == 0.0411
    assert protocol.rig.stroke == 0.020
    dumped = dump_protocol(protocol)
    for line in ("centre_offset: 1 mm", "span: 51 samples", "max_jump: 9 mm", "clamp: Clamp"):
        assert line in dumped


@pytest.mark.parametrize(
    ("shared", "own", "span"),
    [
        ("", "", None),
        (", span: 6 in", "", 0.1524),
        ("", ", span: 5 in", 0.127),
        (", span: 6 in", ", span: 5 in", 0.127),
    ],
)
def test_the_span_of_a_test_goes_before_that_of_its_protocol(
    shared: str, own: str, span: float | None, lab: Path, wire: str, write: Callable[[str], Path]
) -> None:
    protocol = wire.replace("length: 85 mm", f"length: 85 mm{shared}")
    (lab / "protocols" / "wire.yaml").write_text(protocol, encoding="utf-8")
    path = write(SHEET.replace(", length: 80 mm", own))

    specimen = resolve(load_test_sheet(path), path, lab / "protocols").specimen

    assert specimen.length == 0.085
    assert specimen.span == (None if span is None else pytest.approx(span))


def test_a_span_is_given_once(tell: Tell) -> None:
    sheet = SHEET.replace("length: 80 mm", "span: 5 in")

    assert tell(f"{sheet}overrides:\n  specimen.span: {{value: 6 in, because: x}}\n") == [
        f"{Path('test', 'test.yaml')}, line 7, column 26 (overrides.specimen.span.value):"
        " expected 'specimen.span' once, found '6 in' beside '5 in' in 'specimen'. Keep the one in"
        " 'specimen'."
    ]


def test_a_test_names_its_channels_and_dialect(lab: Path, tube: str) -> None:
    (lab / "protocols" / "tube.yaml").write_text(tube, encoding="utf-8")
    path = lab / "test" / "test.yaml"
    path.write_text(
        """\
test: T1
protocol: tube
specimen: {type: T, spool: s, sample: 1, length: 70 mm}
files: {frame: [a.csv, b.csv]}
overrides:
  sources.frame.dialect: {value: own, because: "another program"}
  sources.frame.channels.force.channel: {value: [Kraft, F], because: "German export"}
  sources.frame.channels.force.plausible_peak.to: {value: 5 kN, because: "strong"}
  results.stiffness.to: {value: 6 mm, because: "short"}
  curve.slips: {value: null, because: "glued"}
  results.7: {value: {result: peak-displacement}, because: "no slips"}
""",
        encoding="utf-8",
    )

    protocol = resolve(load_test_sheet(path), path, lab / "protocols")

    assert protocol.sources["frame"].dialect == ("own",)
    assert protocol.channels["force"].channel == ("Kraft", "F")
    assert protocol.channels["force"].peak_range == (20.0, 5000.0)
    assert protocol.curve is not None
    assert protocol.curve.slips is None
    assert [entry.result for entry in protocol.results[6:9]] == [
        "energy-to-break",
        "peak-displacement",
        "slack",
    ]


@pytest.mark.parametrize(
    ("key", "number"),
    [
        ("1", 1),
        ("stiffness_first", 1),
        ("stiffness", 1),
        ("break_point", 2),
        ("segment_stiffness_second", 2),
        ("two-segments", 2),
    ],
)
def test_a_result_is_found_by_number_name_or_kind(
    lab: Path, write: Callable[[str], Path], tube: str, key: str, number: int
) -> None:
    (lab / "protocols" / "wire.yaml").write_text(tube, encoding="utf-8")
    sheet = SHEET.replace("{force: force.mat, markers: [take.csv]}", "{frame: a.csv}")
    path = write(f"{sheet}overrides:\n  results.{key}.to: {{value: 6 mm, because: x}}\n")

    (found,) = (
        at
        for at, entry in enumerate(resolve(load_test_sheet(path), path, lab / "protocols").results)
        if getattr(entry, "stop", None) == 6e-3
    )

    assert found == number


TWO = """\
  - {result: stiffness, from: 1 mm, to: 8 mm}
  - {result: stiffness, name: stiffness_second, from: 10 mm, to: 20 mm}
"""


def test_a_name_goes_before_a_kind(lab: Path, write: Callable[[str], Path], wire: str) -> None:
    """Two of a kind, one of which is called as the kind is."""
    (lab / "protocols" / "wire.yaml").write_text(
        wire.replace("report:", f"{TWO}report:"), encoding="utf-8"
    )
    overrides = "  results.stiffness.to: {value: 6 mm, because: x}\n"
    overrides += "  results.stiffness_second.to: {value: 16 mm, because: x}\n"
    overrides += "  results.peak_force: {value: {result: energy}, because: x}\n"
    path = write(f"{SHEET}overrides:\n{overrides}")

    results = resolve(load_test_sheet(path), path, lab / "protocols").results

    assert [getattr(each, "stop", None) for each in results[-2:]] == [6e-3, 16e-3]
    assert [each.result for each in results[:2]] == ["clock", "energy"]


def test_results_of_one_name_or_kind_need_their_number(lab: Path, tell: Tell, wire: str) -> None:
    two = TWO.replace("stiffness, from", "stiffness, name: stiffness_first, from")
    (lab / "protocols" / "wire.yaml").write_text(
        wire.replace("report:", f"{two}report:"), encoding="utf-8"
    )

    lines = tell(f"{SHEET}overrides:\n  results.stiffness.to: {{value: 6 mm, because: x}}\n")
    (misspelt,) = tell(
        f"{SHEET}overrides:\n  results.stifness_first.to: {{value: 6 mm, because: x}}\n"
    )

    assert lines[0].endswith("that one item of the list has, found 'stiffness'. Use its number.")
    assert misspelt.endswith("found 'stifness_first'. Did you mean 'stiffness_first'?")


def test_a_whole_block_can_be_overridden(lab: Path, write: Callable[[str], Path]) -> None:
    path = write(
        SHEET.replace(", markers: [take.csv]", "")
        + """\
overrides:
  sources: {value: {force: {reader: dspace-mat, channel: a, unit: N}}, because: "no cameras"}
  align: {value: {method: none}, because: "one clock"}
  steps: {value: [], because: "raw"}
  curve: {value: null, because: "no displacement"}
  branches: {value: null, because: "no displacement"}
  results: {value: [], because: "no displacement"}
  report.figures: {value: [], because: "no displacement"}
"""
    )

    protocol = resolve(load_test_sheet(path), path, lab / "protocols")

    assert protocol.align == AlignNone()
    assert (protocol.curve, protocol.results) == (None, ())


STATED = "{method: stated, offset: 1.234 s, drift: -20 ppm, uncertainty: 20 ms"


def test_clocks_are_stated_for_one_test(lab: Path, write: Callable[[str], Path]) -> None:
    """The reason of the override is that of the offset, unless it has its own."""
    for own, said in (("", "the lamp"), (", because: seen in frame 62", "seen in frame 62")):
        text = f"overrides:\n  align: {{value: {STATED}{own}}}, because: the lamp}}\n"
        path = write(SHEET + text)
        align = resolve(load_test_sheet(path), path, lab / "protocols").align
        assert isinstance(align, AlignStated)
        assert (align.offset, align.drift, align.uncertainty) == (1.234, -20e-6, 0.02)
        assert align.because == said
        assert align.channel is None


def test_what_a_statement_lacks(tell: Tell) -> None:
    (found,) = tell(f"{SHEET}overrides:\n  align: {{value: {{method: stated}}, because: x}}\n")
    assert found == (
        "test/test.yaml, line 7, column 18 (align): expected the key 'offset', found no such key. "
        "Add the key 'offset'."
    )


OVERRIDES = {
    "wrong unit": (
        "sources.force.calibration.gain: {value: 0.0411 N, because: x}",
        "test/test.yaml, line 7, column 43 (sources.force.calibration.gain): expected a quantity"
        " with a unit such as N/V, found '0.0411 N'. N is a unit of force."
        " Write it with its unit, such as '0.5 N/V'.",
    ),
    "unknown key": (
        "rig.strok: {value: 3 mm, because: x}",
        "test/test.yaml, line 7, column 3 (rig.strok): expected one of the keys 'stroke', 'string',"
        " 'crosshead_speed', 'cycles', found 'strok'. Did you mean 'stroke'?",
    ),
    "unknown block": (
        "rigg.stroke: {value: 3 mm, because: x}",
        "test/test.yaml, line 7, column 3 (rigg): expected one of the keys 'rig', 'align',"
        " 'version', 'curve', 'groups', 'report', ..., found 'rigg'. Did you mean 'rig'?",
    ),
    "below a value": (
        "rig.cycles.x: {value: 3, because: x}",
        "test/test.yaml, line 7, column 3 (overrides.rig.cycles.x): expected a key of the protocol,"
        " found 'x' below a plain value.",
    ),
    "unknown step": (
        "steps.smoth.span: {value: 1 s, because: x}",
        "test/test.yaml, line 7, column 3 (overrides.steps.smoth.span): expected a number from 0 to"
        " 4, or a name that one item of the list has, found 'smoth'. Did you mean 'smooth'?",
    ),
    "step beyond the last": (
        "steps.9.span: {value: 1 s, because: x}",
        "test/test.yaml, line 7, column 3 (overrides.steps.9.span): expected a number from 0 to 4,"
        " or a name that one item of the list has, found '9'. Did you mean 'fit-shape'?",
    ),
    "within a block": (
        "results: {value: [{result: clock}, {result: enrgy}], because: x}",
        "test/test.yaml, line 7, column 47 (results.1.result): expected one of 'energy',"
        " 'energy-to-break', 'hardening', 'moment-curvature', 'bending-stiffness',"
        " 'peak-force', ...,"
        " found 'enrgy'. Did you mean 'energy'?",
    ),
    "elsewhere": (
        "markers.clamp: {value: null, because: x}",
        "protocols/wire.yaml, line 14, column 17 (align.method): expected a clamp whose motion has"
        " the turning points, found none. Name the rigid body at the clamp in 'markers.clamp'."
        " (With what test/test.yaml changes.)",
    ),
    "length twice": (
        "specimen.length: {value: 3 mm, because: x}",
        "test/test.yaml, line 7, column 28 (overrides.specimen.length.value): expected"
        " 'specimen.length' once, found '3 mm' beside '80 mm' in 'specimen'."
        " Keep the one in 'specimen'.",
    ),
}


@pytest.mark.parametrize("case", OVERRIDES.values(), ids=OVERRIDES)
def test_a_wrong_override_is_told_where_the_test_sheet_has_it(
    case: tuple[str, str], tell: Tell
) -> None:
    override, message = case

    assert message.replace("/", os.sep, message.split(":")[0].count("/")) in tell(
        f"{SHEET}overrides:\n  {override}\n"
    )


def test_thousands_of_overrides_are_placed_each(tell: Tell) -> None:
    """In time that grows with their number: each once went through all places of the sheet."""
    keys = [f"report.display.x{number}" for number in range(5000)]
    lines = "".join(f"  {key}: {{value: mm, because: x}}\n" for key in keys)

    messages = tell(f"{SHEET}overrides:\n{lines}")

    places = [message.partition(": expected")[0] for message in messages]
    file = Path("test", "test.yaml")
    assert places == [f"{file}, line {n}, column 3 ({key})" for n, key in enumerate(keys, 7)]


def test_an_override_of_a_block_and_of_a_key_in_it(
    lab: Path, write: Callable[[str], Path], tell: Tell
) -> None:
    block = "  rig.string: {value: {length: 5 mm, counterweight: 1 g}, because: x}\n"
    key = "  rig.string.length: {value: 6 mm, because: x}\n"
    path = write(f"{SHEET}overrides:\n{block}{key}")
    string = resolve(load_test_sheet(path), path, lab / "protocols").rig.string
    assert string is not None
    assert (string.length, string.counterweight) == (0.006, 0.001)

    wrong = (block + key).replace("1 g", "1 s").replace("6 mm", "6 s")
    assert [message.partition(": ")[0] for message in tell(f"{SHEET}overrides:\n{wrong}")] == [
        f"{Path('test', 'test.yaml')}, line 7, column 53 (rig.string.counterweight)",
        f"{Path('test', 'test.yaml')}, line 8, column 30 (rig.string.length)",
    ]


def test_a_step_that_is_there_twice_needs_its_number(lab: Path, tell: Tell, wire: str) -> None:
    step = "  - {step: zero, channel: force, over: 2 s}\n"
    (lab / "protocols" / "wire.yaml").write_text(wire.replace(step, step * 2), encoding="utf-8")

    lines = tell(f"{SHEET}overrides:\n  steps.zero.over: {{value: 1 s, because: x}}\n")

    assert lines[0].endswith("that one item of the list has, found 'zero'. Use its number.")


def tube_of(
    lab: Path, tube: str, write: Callable[[str], Path], overrides: str, main: str = ""
) -> Protocol:
    """The protocol of a tube after overrides, one a line."""
    tube = (
        tube.replace("stiffness_first, peak_force.2], scaled", f"{main}], scaled") if main else tube
    )
    (lab / "protocols" / "tube.yaml").write_text(tube, encoding="utf-8")
    sheet = SHEET.replace("protocol: wire", "protocol: tube")
    sheet = re.sub(r"files: .*", "files: {frame: a.txt}", sheet)
    lines = "".join(f"  {line}\n" for line in overrides.split("\n"))
    path = write(f"{sheet}overrides:\n{lines}")
    return resolve(load_test_sheet(path), path, lab / "protocols")


NO_SLACK = """\
curve.slack: {value: null, because: nothing is slack}
results.slack: {value: null, because: nothing is slack}"""


def test_a_result_is_taken_out(lab: Path, tube: str, write: Callable[[str], Path]) -> None:
    protocol = tube_of(lab, tube, write, NO_SLACK)

    assert protocol.curve is not None
    assert protocol.curve.slack is None
    assert "slack" not in [entry.result for entry in protocol.results]
    assert len(protocol.results) == 9


@pytest.mark.parametrize("order", [1, -1])
def test_numbers_are_those_of_the_protocol_whatever_is_taken_out(
    lab: Path, tube: str, write: Callable[[str], Path], order: int
) -> None:
    changes = (
        "results.0: {value: null, because: x}",
        "results.1.to: {value: 9 mm, because: x}",
        "results.7: {value: null, because: x}",
        "results.9.to: {value: 390 N, because: x}",
    )
    protocol = tube_of(lab, tube, write, "\n".join(changes[::order]))

    first, *_, last = protocol.results
    assert isinstance(first, LineStiffness)
    assert isinstance(last, ComplianceResult)
    assert (first.stop, last.stop) == (9e-3, 390.0)
    assert len(protocol.results) == 8


def test_what_is_taken_out_is_not_shown_first(
    lab: Path, tube: str, write: Callable[[str], Path]
) -> None:
    main = "peak_force.1, failure_force, slack, failure_displacement"
    gone = "results.failure: {value: null, because: did not break}"
    protocol = tube_of(lab, tube, write, gone, main)

    assert protocol.groups.main == ("peak_force.1", "slack")


def test_a_fault_behind_what_was_taken_out_has_its_own_number(
    lab: Path, tube: str, write: Callable[[str], Path]
) -> None:
    changes = """\
results.0: {value: null, because: x}
results.compliance.to: {value: 3 mm, because: x}"""
    with pytest.raises(ProtocolError) as refused:
        tube_of(lab, tube, write, changes)
    assert "test.yaml, line 8, column 34 (results.9.to): expected a quantity" in str(refused.value)


def test_a_step_is_taken_out_and_the_others_keep_their_keys(
    lab: Path, tube: str, write: Callable[[str], Path]
) -> None:
    step = "  - {step: smooth, channel: force, method: moving-average, span: 5 samples}\n"
    tube = tube.replace("curve:\n", f"{step}curve:\n", 1)
    protocol = tube_of(lab, tube, write, "steps.zero: {value: null, because: none}")

    (left,) = protocol.steps
    assert (left.step, left.key) == ("smooth", "steps.1")


def test_a_result_that_others_are_made_of_stays(
    lab: Path, tube: str, write: Callable[[str], Path]
) -> None:
    gone = "results.stiffness_first: {value: null, because: x}"
    with pytest.raises(ProtocolError, match=r"\(results\.3\.of\): expected one of the stiffnesses"):
        tube_of(lab, tube, write, gone)


def test_an_item_of_a_list_that_the_protocol_leaves_out(
    lab: Path, tube: str, write: Callable[[str], Path]
) -> None:
    bare = re.sub(r"steps:\n.*\n", "", tube)
    assert "steps" not in bare
    with pytest.raises(ProtocolError) as refused:
        tube_of(lab, bare, write, "steps.0.over: {value: 1 s, because: x}")
    assert str(refused.value).endswith(
        "(overrides.steps.0.over): expected a key of the protocol, which has no 'steps', found"
        " 'steps.0.over'. Override 'steps' as a whole."
    )
