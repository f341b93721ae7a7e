"""What a test changes in its protocol, leaves out of it, and may not do."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import nullcontext
from datetime import date
from pathlib import Path

import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.load import (
    find_missing_curve_sources,
    format_protocol,
    load_protocol,
    load_test_sheet,
    parse_protocol,
    remove_absent_sources,
    resolve_protocol,
)
from labpipe.protocol.schema import AlignNone, AlignStated, Protocol
from labpipe.protocol.source import PLAUSIBLE_RANGES
from labpipe.results.stiffness import ComplianceResult, LineStiffness
from tests.protocol.conftest import SHEET, Tell

Resolved = Callable[..., Protocol]


TUBE_SHEET = """\
test: T1
protocol: tube
specimen: {type: T, spool: s, sample: 1, length: 70 mm}
files: {frame: [a.csv, b.csv]}
"""


@pytest.fixture
def resolved(lab: Path, wire: str, tube: str, write: Callable[[str], Path]) -> Resolved:
    """The protocol of a test after its overrides, one a line."""

    def resolved(
        *overrides: str, sheet: str = SHEET, change: tuple[str, str] = ("", "")
    ) -> Protocol:
        for name, protocol in (("wire", wire), ("tube", tube)):
            text = protocol.replace(*change) if change[0] else protocol
            (lab / "protocols" / f"{name}.yaml").write_text(text, encoding="utf-8")
        lines = "".join(f"  {override}\n" for override in overrides)
        path = write(f"{sheet}overrides:\n{lines}" if overrides else sheet)
        return resolve_protocol(load_test_sheet(path), path, lab / "protocols")

    return resolved


def gone(*keys: str) -> list[str]:
    return [f"{key}: {{value: null, because: x}}" for key in keys]


def test_a_test_puts_its_own_values_into_its_protocol(resolved: Resolved) -> None:
    protocol = resolved(
        "sources.force.calibration.gain: {value: 0.0411 N/V, because: another cell}",
        "markers.centre_offset: {value: 1 mm, because: flat markers}",
        "steps.smooth.span: {value: 51 samples, because: slow recorder}",
        "steps.0.max_jump: {value: 9 mm, because: fast}",
        "rig.stroke: {value: 20 mm, because: short}",
    )
    assert protocol.specimen.length == 0.080
    assert protocol.channels["force"].gain == 0.0411
    assert protocol.rig.stroke == 0.020
    dumped = format_protocol(protocol)
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
    shared: str, own: str, span: float | None, resolved: Resolved
) -> None:
    change = ("length: 85 mm", f"length: 85 mm{shared}")
    specimen = resolved(sheet=SHEET.replace(", length: 80 mm", own), change=change).specimen
    assert specimen.length == 0.085
    assert specimen.span == (None if span is None else pytest.approx(span))


def test_a_test_names_its_channels_and_dialect(resolved: Resolved) -> None:
    protocol = resolved(
        "sources.frame.dialect: {value: own, because: another program}",
        "sources.frame.channels.force.channel: {value: [Kraft, F], because: German export}",
        "sources.frame.channels.force.plausible_peak.to: {value: 5 kN, because: strong}",
        "curve.slips: {value: null, because: glued}",
        "results.7: {value: {result: peak-displacement}, because: no slips}",
        sheet=TUBE_SHEET,
    )
    assert protocol.sources["frame"].dialect == ("own",)
    assert protocol.channels["force"].channel == ("Kraft", "F")
    assert protocol.channels["force"].peak_range == (20.0, 5000.0)
    assert protocol.curve is not None
    assert protocol.curve.slips is None
    kinds = [entry.result for entry in protocol.results[6:9]]
    assert kinds == ["energy-to-break", "peak-displacement", "slack"]


@pytest.mark.parametrize(
    ("key", "number"),
    [
        *(("1", 1), ("stiffness_first", 1), ("stiffness", 1)),
        *(("break_point", 2), ("segment_stiffness_second", 2), ("two-segments", 2)),
    ],
)
def test_a_result_is_found_by_number_name_or_kind(
    resolved: Resolved, key: str, number: int
) -> None:
    protocol = resolved(f"results.{key}.to: {{value: 6 mm, because: x}}", sheet=TUBE_SHEET)
    ends = [getattr(entry, "stop", None) for entry in protocol.results]
    assert ends.index(6e-3) == number


def test_an_override_of_a_block_and_of_a_key_in_it(resolved: Resolved, tell: Tell) -> None:
    block = "rig.string: {value: {length: 5 mm, counterweight: 1 g}, because: x}"
    key = "rig.string.length: {value: 6 mm, because: x}"
    string = resolved(block, key).rig.string
    assert string is not None
    assert (string.length, string.counterweight) == (0.006, 0.001)

    wrong = f"  {block}\n  {key}\n".replace("1 g", "1 s").replace("6 mm", "6 s")
    assert [message.partition(": ")[0] for message in tell(f"{SHEET}overrides:\n{wrong}")] == [
        f"{Path('test', 'test.yaml')}, line 7, column 53 (rig.string.counterweight)",
        f"{Path('test', 'test.yaml')}, line 8, column 30 (rig.string.length)",
    ]


def test_a_result_is_taken_out(resolved: Resolved) -> None:
    """And is not shown first then; but not one that others are made of, nor an item of no list."""
    main = "peak_force.1, failure_force, slack, failure_displacement], scaled"
    change = ("stiffness_first, peak_force.2], scaled", main)
    changes = gone("curve.slack", "results.failure")
    protocol = resolved(*changes, "results.slack: {value: null, because: x}", sheet=TUBE_SHEET)
    kinds = [entry.result for entry in protocol.results]
    assert protocol.curve is not None
    assert (protocol.curve.slack, "slack" in kinds, len(kinds)) == (None, False, 8)
    protocol = resolved(gone("results.failure")[0], sheet=TUBE_SHEET, change=change)
    assert protocol.groups.main == ("peak_force.1", "slack")
    with pytest.raises(ProtocolError, match=r"\(results\.3\.of\): expected one of the st"):
        resolved(*gone("results.stiffness_first"), sheet=TUBE_SHEET)
    for override in (
        "results: {value: [{result: peak-force}], because: x}",
        "results.stiffness_first.name: {value: k_1, because: x}",
    ):
        with pytest.raises(
            ProtocolError, match=r"\(groups\.main\.0\): expected one of the results"
        ):
            resolved(override, sheet=TUBE_SHEET)
    no_steps = ("steps:\n  - {step: zero, channel: force, over: 0.1 s, by: line}\n", "")
    with pytest.raises(
        ProtocolError, match=r"no 'steps', found 'steps\.0\.over'\. Override 'steps'"
    ):
        resolved("steps.0.over: {value: 1 s, because: x}", sheet=TUBE_SHEET, change=no_steps)


def test_whole_blocks_are_overridden(resolved: Resolved) -> None:
    """The reason of the override is that of the offset of a clock, unless it has its own."""
    protocol = resolved(
        "sources: {value: {force: {reader: dspace-mat, channel: a, unit: N}}, because: alone}",
        "align: {value: {method: none}, because: one clock}",
        *(f"{key}: {{value: [], because: x}}" for key in ("steps", "results", "report.figures")),
        *gone("curve", "branches"),
        sheet=SHEET.replace(", markers: [take.csv]", ""),
    )
    assert (protocol.align, protocol.curve, protocol.results) == (AlignNone(), None, ())
    stated = "{method: stated, offset: 1.234 s, drift: -20 ppm, uncertainty: 20 ms"
    for clause, reason in (("", "the lamp"), (", because: seen in frame 62", "seen in frame 62")):
        align = resolved(f"align: {{value: {stated}{clause}}}, because: the lamp}}").align
        assert isinstance(align, AlignStated)
        assert (align.offset, align.drift, align.uncertainty) == (1.234, -20e-6, 0.02)
        assert (align.because, align.channel) == (reason, None)


@pytest.mark.parametrize("order", [1, -1])
def test_numbers_are_those_of_the_protocol_whatever_is_taken_out(
    resolved: Resolved, order: int
) -> None:
    changes = (
        *gone("results.0"),
        "results.1.to: {value: 9 mm, because: x}",
        *gone("results.7"),
        "results.9.to: {value: 390 N, because: x}",
    )
    line, *between, compliance = resolved(*changes[::order], sheet=TUBE_SHEET).results
    assert isinstance(line, LineStiffness)
    assert isinstance(compliance, ComplianceResult)
    assert (line.stop, compliance.stop, len(between)) == (9e-3, 390.0, 6)


CONDUIT = Path(__file__).parents[2] / "protocols" / "conduit-bundle.yaml"


CONDUIT_SHEET = """\
test: C1-1
protocol: conduit-bundle
specimen: {type: CWB-1, spool: s1, sample: 1}
files: {%s}
"""


def test_what_is_left_without_a_file() -> None:
    """A protocol on one clock, whose steps keep the numbers that the whole one gives them."""
    full_protocol = load_protocol(CONDUIT)
    reduced = remove_absent_sources(full_protocol, ["force"])
    steps = [f"{step.step} {getattr(step, 'channel', '')}".strip() for step in reduced.steps]
    assert steps == ["zero force", "travel-from-speed displacement", "smooth force"]
    assert (reduced.align, reduced.steps[0].key) == (AlignNone(), "steps.3")
    assert "clock" not in [result.result for result in reduced.results]
    assert list(find_missing_curve_sources(reduced, full_protocol)) == []
    without_speed = re.sub(".*crosshead_speed.*\n", "", format_protocol(reduced))
    with pytest.raises(ProtocolError, match=r"expected 'rig\.crosshead_speed' for 'travel-from-sp"):
        parse_protocol(without_speed, "p.yaml")
    for roles in (["force", "frame"], ["force", "markers"]):
        reduced = remove_absent_sources(full_protocol, roles)
        parsed_again = parse_protocol(format_protocol(reduced), "result.h5")
        # The steps of the two protocols know other numbers.
        assert format_protocol(parsed_again) == format_protocol(reduced)
        assert [step.key for step in reduced.steps] == [
            f"steps.{full_protocol.steps.index(step)}" for step in reduced.steps
        ]


CONDUIT_FAULTS = {
    "neither frame nor speed": (
        "force: a.mat",
        r"crosshead_speed: 0\.5 mm/s, ",
        "the role 'frame', or 'rig.crosshead_speed', for the channel 'displacement'",
    ),
    "neither frame nor a step that makes it": (
        "force: a.mat",
        r".*travel-from-speed.*\n",
        "expected a file in the role 'frame' for the channel 'displacement', found none.",
    ),
    "not optional": ("frame: a.txt", "$^", "expected a file in the role 'force', found none."),
}


@pytest.mark.parametrize("name", CONDUIT_FAULTS)
def test_a_role_without_file(lab: Path, write: Callable[[str], Path], name: str) -> None:
    files, pattern, message = CONDUIT_FAULTS[name]
    text = re.sub(pattern, "", CONDUIT.read_text(encoding="utf-8"))
    (lab / "protocols" / "conduit-bundle.yaml").write_text(text, encoding="utf-8")
    path = write(CONDUIT_SHEET % files)
    with pytest.raises(ProtocolError, match=re.escape(message)):
        resolve_protocol(load_test_sheet(path), path, lab / "protocols")


LINKED_SHEET = """\
test: A1
protocol: own
specimen: {type: A, spool: s, sample: 1}
"""
PROTOCOL = "version: 1\nname: own\nsources: {force: {reader: dspace-mat, channel: x, unit: N}}\n"
FOLLOWED_BY_TEST = "overrides: {follow_links: {value: true, because: x}}\n"
OUTSIDE = "line 4, column 16 (files.force): expected a file inside the folder of the test, found"
LOOP = "expected a file, found 'force.mat', a link to itself."


@pytest.mark.parametrize(
    ("target", "protocol", "sheet", "follow_links", "message"),
    [
        ("../store/001.mat", "", "", False, f"{OUTSIDE} 'force.mat', a link out of it"),
        ("../store/001.mat", "follow_links: false\n", "", False, "a link out of it"),
        ("../store/001.mat", "", "", True, ""),
        ("../store/001.mat", "follow_links: true\n", "", False, ""),
        ("../store/001.mat", "follow_links: True\n", "", False, ""),
        ("../store/001.mat", "follow_links: perhaps\n", "", False, "expected true or false"),
        ("../store/001.mat", "", FOLLOWED_BY_TEST, False, "a link out of it"),
        ("../store/001.mat", "", FOLLOWED_BY_TEST, False, "(overrides.follow_links): expected"),
        ("first.mat", "", "", False, ""),
        ("force.mat", "", "", True, LOOP),
        ("force.mat", "", "", False, LOOP),
        ("first.mat", "", "files: {force: ../store/001.mat}", True, OUTSIDE),
        ("first.mat", "", "files: {force: /etc/hostname}", True, OUTSIDE),
    ],
)
def test_links(
    lab: Path, target: str, protocol: str, sheet: str, follow_links: bool, message: str
) -> None:
    """Followed out of the folder where the command or the protocol says so, not the test.

    A path that leaves the folder is never followed.
    """
    (lab / "store").mkdir()
    (lab / "store" / "001.mat").write_bytes(b"synthetic")
    (lab / "test" / "first.mat").write_bytes(b"synthetic")
    (lab / "test" / "force.mat").symlink_to(target)
    (lab / "protocols" / "own.yaml").write_text(PROTOCOL + protocol, encoding="utf-8")
    path = lab / "test" / "test.yaml"
    files = "" if sheet.startswith("files: ") else "files: {force: force.mat}\n"
    path.write_text(LINKED_SHEET + files + sheet, encoding="utf-8")
    refused = pytest.raises(ProtocolError, match=re.escape(message)) if message else nullcontext()
    with refused:
        resolve_protocol(load_test_sheet(path), path, lab / "protocols", follow_links=follow_links)


LENGTH = "length: 80 mm"


@pytest.mark.parametrize("ends", ["{from: 1 mm, to: 100 km}", "{to: 100 km}"])
def test_a_test_or_a_protocol_widens_a_range(resolved: Resolved, ends: str) -> None:
    long_sheet = SHEET.replace(LENGTH, "length: 100 km")
    protocol = resolved(f"plausible.length: {{value: {ends}, because: x}}", sheet=long_sheet)
    assert protocol.specimen.length == 1e5
    assert protocol.plausible["length"].start == "1 mm"
    assert protocol.plausible["span"].stop == PLAUSIBLE_RANGES["span"][2]
    assert parse_protocol(format_protocol(protocol), "result.h5") == protocol

    change = ("version: 1\n", f"version: 1\nplausible: {{length: {ends}}}\n")
    assert resolved(sheet=long_sheet, change=change).specimen.length == 1e5


CERTIFICATE = "{number: LC-7 / 2026, date: 2026-01-10, due: 2027-01-10, uncertainty: 0.5 %}"


FORCE = "unit: V\n"
"""Where a key of the channel of the force can be added."""


def read_again(protocol: Protocol) -> Protocol:
    """The same, written and read again."""
    parsed = parse_protocol(format_protocol(protocol), "again.yaml")
    assert parsed == protocol
    return parsed


@pytest.mark.parametrize(
    ("stated", "standard"),
    [("0.5 %", 0.0025), ("0.5 %, k: 1", 0.005), ("0.6 %, k: 3", 0.002), ("0 %", 0.0)],
)
def test_a_certificate_states_k_times_the_standard_uncertainty(
    wire: str, stated: str, standard: float
) -> None:
    text = wire.replace(", gain_uncertainty: 0.2 %", "")
    text = text.replace(FORCE, f"{FORCE}    certificate: {CERTIFICATE}\n").replace("0.5 %", stated)
    force = read_again(parse_protocol(text, "p.yaml")).channels["force"]
    assert force.gain_uncertainty == pytest.approx(standard, rel=1e-12)
    assert force.certificate is not None
    assert force.certificate.number == "LC-7 / 2026"
    assert (force.certificate.date, force.certificate.due) == (date(2026, 1, 10), date(2027, 1, 10))


@pytest.mark.parametrize(
    ("stated", "standard"),
    [
        ("", 0.0),
        ("    scale_uncertainty: 0.05 %\n", 0.0005),
        (f"    certificate: {CERTIFICATE}\n", 0.0025),
        (f"    scale_uncertainty: 0.25 %\n    certificate: {CERTIFICATE}\n", 0.0025),
    ],
)
def test_cameras_have_a_scale(wire: str, stated: str, standard: float) -> None:
    text = wire.replace("reader: motive-csv\n", f"reader: motive-csv\n{stated}")
    cameras = read_again(parse_protocol(text, "p.yaml")).sources["markers"]
    assert cameras.gain_uncertainty == pytest.approx(standard)
    assert cameras.all_channels == {}


def test_uncertainties_of_channels_and_sizes(wire: str, tube: str) -> None:
    """A calibration of 0.2 % and a scale of 0.15 % are the 0.25 % of the certificate, k = 2.

    The zero of one channel named like its role drifts, and of one of several; 0 is stated, too.
    """
    keys = "scale_uncertainty: 0.15 %", f"certificate: {CERTIFICATE}", "zero_drift: 0.12 %"
    text = wire.replace(FORCE, FORCE + "".join(f"    {key}\n" for key in keys))
    force = read_again(parse_protocol(text, "p.yaml")).channels["force"]
    assert force.gain_uncertainty == pytest.approx(0.0025)
    assert force.zero_drift == 0.0012
    assert read_again(parse_protocol(wire, "p.yaml")).channels["force"].zero_drift is None
    sizes = "thickness: 0.3 mm}, uncertainty: {length: 0.5 mm, thickness: 6 um, area: 0.05 mm^2}}"
    text = tube.replace("force: {", "force: {zero_drift: 0, ", 1)
    protocol = read_again(parse_protocol(text.replace("thickness: 0.3 mm}}", sizes), "p.yaml"))
    drifts = {name: channel.zero_drift for name, channel in protocol.channels.items()}
    assert drifts == {"force": 0.0, "displacement": None}
    assert protocol.specimen.uncertainty is not None
    assert protocol.specimen.uncertainty.by_key == pytest.approx(
        {"length": 5e-4, "thickness": 6e-6, "area": 5e-8}
    )


@pytest.mark.parametrize(
    ("own", "overrides"),
    [
        (", uncertainty: {length: 1 mm}", []),
        ("", ["specimen.uncertainty.length: {value: 1 mm, because: bent}"]),
    ],
)
def test_a_test_has_uncertainties_of_its_own(
    own: str, overrides: list[str], resolved: Resolved
) -> None:
    shared = "{length: 85 mm, uncertainty: {length: 2 mm, wall: 1 um}}"
    sheet = SHEET.replace("length: 80 mm", f"length: 80 mm{own}")
    specimen = resolved(*overrides, sheet=sheet, change=("{length: 85 mm}", shared)).specimen
    assert specimen.uncertainty is not None
    assert specimen.uncertainty.by_key == {"length": 0.001, "wall": 1e-6}
