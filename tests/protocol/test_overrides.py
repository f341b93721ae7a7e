"""What a test changes in its protocol, leaves out of it, and may not do."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import date
from pathlib import Path

import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.load import (
    dump_protocol,
    load_harness,
    load_protocol,
    load_test_sheet,
    parse_protocol,
    resolve,
)
from labpipe.protocol.overrides import absent_faults, without_absent
from labpipe.protocol.plausible import PLAUSIBLE
from labpipe.protocol.schema import AlignNone, AlignStated, Protocol
from labpipe.results.stiffness import ComplianceResult, LineStiffness
from tests.protocol.conftest import SHEET, Tell, Told

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
        return resolve(load_test_sheet(path), path, lab / "protocols")

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


def test_a_whole_block_can_be_overridden(resolved: Resolved) -> None:
    protocol = resolved(
        "sources: {value: {force: {reader: dspace-mat, channel: a, unit: N}}, because: alone}",
        "align: {value: {method: none}, because: one clock}",
        *(f"{key}: {{value: [], because: x}}" for key in ("steps", "results", "report.figures")),
        *gone("curve", "branches"),
        sheet=SHEET.replace(", markers: [take.csv]", ""),
    )
    assert protocol.align == AlignNone()
    assert (protocol.curve, protocol.results) == (None, ())


STATED = "{method: stated, offset: 1.234 s, drift: -20 ppm, uncertainty: 20 ms"


def test_clocks_are_stated_for_one_test(resolved: Resolved) -> None:
    """The reason of the override is that of the offset, unless it has its own."""
    for own, reason in (("", "the lamp"), (", because: seen in frame 62", "seen in frame 62")):
        align = resolved(f"align: {{value: {STATED}{own}}}, because: the lamp}}").align
        assert isinstance(align, AlignStated)
        assert (align.offset, align.drift, align.uncertainty) == (1.234, -20e-6, 0.02)
        assert align.because == reason
        assert align.channel is None


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
    protocol = resolved(*gone("curve.slack", "results.slack"), sheet=TUBE_SHEET)
    assert protocol.curve is not None
    assert protocol.curve.slack is None
    assert "slack" not in [entry.result for entry in protocol.results]
    assert len(protocol.results) == 9


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
    first, *rest, last = resolved(*changes[::order], sheet=TUBE_SHEET).results
    assert isinstance(first, LineStiffness)
    assert isinstance(last, ComplianceResult)
    assert (first.stop, last.stop, len(rest)) == (9e-3, 390.0, 6)


def test_what_is_taken_out_is_not_shown_first(resolved: Resolved) -> None:
    main = "peak_force.1, failure_force, slack, failure_displacement], scaled"
    change = ("stiffness_first, peak_force.2], scaled", main)
    protocol = resolved(*gone("results.failure"), sheet=TUBE_SHEET, change=change)
    assert protocol.groups.main == ("peak_force.1", "slack")


@pytest.mark.parametrize(
    ("override", "change", "message"),
    [
        (
            gone("results.stiffness_first")[0],
            ("", ""),
            r"\(results\.3\.of\): expected one of the st",
        ),
        (
            "steps.0.over: {value: 1 s, because: x}",
            ("steps:\n  - {step: zero, channel: force, over: 0.1 s, by: line}\n", ""),
            r"has no 'steps', found 'steps\.0\.over'\. Override 'steps' as a whole\.$",
        ),
    ],
    ids=["others are made of it", "an item of no list"],
)
def test_what_a_test_cannot_change(
    resolved: Resolved, override: str, change: tuple[str, str], message: str
) -> None:
    with pytest.raises(ProtocolError, match=message):
        resolved(override, sheet=TUBE_SHEET, change=change)


CONDUIT = Path(__file__).parents[2] / "protocols" / "conduit-bundle.yaml"


CONDUIT_SHEET = """\
test: C1-1
protocol: conduit-bundle
specimen: {type: CWB-1, spool: s1, sample: 1}
files: {%s}
"""


@pytest.fixture
def whole() -> Protocol:
    return load_protocol(CONDUIT)


def steps(protocol: Protocol) -> list[str]:
    return [f"{step.step} {getattr(step, 'channel', '')}".strip() for step in protocol.steps]


def test_without_a_frame_the_displacement_is_made_on_one_clock(whole: Protocol) -> None:
    kept = without_absent(whole, ["force"])

    assert steps(kept) == ["zero force", "travel-from-speed displacement", "smooth force"]
    assert kept.align == AlignNone()
    assert "clock" not in [result.result for result in kept.results]
    assert list(absent_faults(kept, whole)) == []


@pytest.mark.parametrize("roles", [["force", "frame"], ["force", "markers"]])
def test_what_is_left_is_a_protocol(whole: Protocol, roles: list[str]) -> None:
    kept = without_absent(whole, roles)

    again = parse_protocol(dump_protocol(kept), "result.h5")
    assert dump_protocol(again) == dump_protocol(kept)  # its steps know other numbers


def test_a_step_keeps_the_number_that_the_protocol_gives_it(whole: Protocol) -> None:
    kept = without_absent(whole, ["force", "frame"])
    numbers = {step.key: number for number, step in enumerate(whole.steps)}
    assert list(numbers) == [f"steps.{number}" for number in range(len(whole.steps))]
    assert [numbers[step.key] for step in kept.steps] == [whole.steps.index(x) for x in kept.steps]
    assert kept.steps[0].key != "steps.0"


CONDUIT_FAULTS = {
    "neither frame nor speed": (
        "force: a.mat",
        r"crosshead_speed: 0\.5 mm/s, ",
        "expected a file in the role 'frame', or 'rig.crosshead_speed' to make 'displacement' from",
    ),
    "neither frame nor a step that makes it": (
        "force: a.mat",
        r".*travel-from-speed.*\n",
        "expected a file in the role 'frame', which gives 'displacement', found none.",
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
        resolve(load_test_sheet(path), path, lab / "protocols")


def test_a_step_without_speed_where_no_source_measures(whole: Protocol) -> None:
    text = dump_protocol(without_absent(whole, ["force"]))
    lines = [line for line in text.splitlines() if "crosshead_speed" not in line]
    with pytest.raises(ProtocolError, match=r"expected 'rig\.crosshead_speed' for 'travel-from-sp"):
        parse_protocol("\n".join(lines), "p.yaml")


LINKED_SHEET = """\
test: A1
protocol: own
specimen: {type: A, spool: s, sample: 1}
files: {force: force.mat}
"""
PROTOCOL = "version: 1\nname: own\nsources: {force: {reader: dspace-mat, channel: x, unit: N}}\n"
FOLLOWED_BY_TEST = "overrides: {follow_links: {value: true, because: x}}\n"
OUTSIDE = "line 4, column 16 (files.force): expected a file inside the folder of the test, found"
LOOP = "expected a file, found 'force.mat', a link that leads back to itself. Make the link again."


@pytest.mark.parametrize(
    ("target", "protocol", "sheet", "follow_links", "message"),
    [
        ("../store/001.mat", "", "", False, f"{OUTSIDE} 'force.mat', a link out of it"),
        ("../store/001.mat", "follow_links: false\n", "", False, "a link out of it"),
        ("../store/001.mat", "", "", True, ""),
        ("../store/001.mat", "follow_links: true\n", "", False, ""),
        ("../store/001.mat", "follow_links: True\n", "", False, ""),
        ("../store/001.mat", "", FOLLOWED_BY_TEST, False, "a link out of it"),
        ("../store/001.mat", "", FOLLOWED_BY_TEST, False, "(overrides.follow_links): expected"),
        ("first.mat", "", "", False, ""),
        ("force.mat", "", "", True, LOOP),
        ("force.mat", "", "", False, LOOP),
    ],
)
def test_links(
    lab: Path, target: str, protocol: str, sheet: str, follow_links: bool, message: str
) -> None:
    """Followed out of the folder where the command or the protocol says so, not the test."""
    (lab / "store").mkdir()
    (lab / "store" / "001.mat").write_bytes(b"synthetic")
    (lab / "test" / "first.mat").write_bytes(b"synthetic")
    (lab / "test" / "force.mat").symlink_to(target)
    answer = refusal(lab, protocol, LINKED_SHEET + sheet, follow_links=follow_links)
    assert message in answer
    assert (answer == "") == (message == "")


def refusal(lab: Path, protocol: str, sheet: str, *, follow_links: bool) -> str:
    """Why a test is refused; empty if it is not."""
    (lab / "protocols" / "own.yaml").write_text(PROTOCOL + protocol, encoding="utf-8")
    path = lab / "test" / "test.yaml"
    path.write_text(sheet, encoding="utf-8")
    try:
        resolve(load_test_sheet(path), path, lab / "protocols", follow_links=follow_links)
    except ProtocolError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("name", ["../store/001.mat", "/etc/hostname"])
def test_a_path_that_leaves_the_folder_is_never_followed(lab: Path, name: str) -> None:
    sheet = LINKED_SHEET.replace("force.mat", name)
    assert "expected a file inside the folder of the test" in refusal(
        lab, "", sheet, follow_links=True
    )


LENGTH = "length: 80 mm"


@pytest.mark.parametrize(
    ("written", "key", "wider"),
    [
        ("length: 100 km", "specimen.length", "plausible.length.to: {value: 100 km"),
        ("length: 80 um", "specimen.length", "plausible.length.from: {value: 80 um"),
        ("span: 76 m", "specimen.span", "plausible.span.to: {value: 76 m"),
        ("outer_diameter: 2.1 m", "specimen.outer_diameter", "plausible.diameter.to"),
        ("wall_thickness: 0.4 m", "specimen.wall_thickness", "plausible.wall.to"),
        ("mandrel: 3 km", "specimen.mandrel", "plausible.other.to"),
        ("mass_per_length: 60 kg/m", "specimen.mass_per_length", "plausible.mass_per_length.to"),
        ("bundle: {wires: {B1: {number: 2, diameter: 1.1 m}}}", "wires.B1.diameter", "diameter.to"),
        ("bundle: {wires: 2 B1 (1.1 m)}", "wires.B1.diameter", "plausible.diameter.to"),
        ("bundle: {wires: 2 B1, conduit: x, conduit_bore: 8 m}", "conduit_bore", "diameter.to"),
    ],
)
def test_an_implausible_size_of_a_specimen_is_refused(
    tell: Tell, written: str, key: str, wider: str
) -> None:
    (message,) = tell(SHEET.replace(LENGTH, written))

    place, _, rest = message.partition(": expected a plausible ")
    assert place.startswith(f"{Path('test', 'test.yaml')}, line 3, column ")
    assert place.endswith(f"{key})")
    assert wider in rest


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("length: 760 mm", "length: 760 m", "rig.string.length"),
        ("1 mm/s, cycles", "9 m/s, cycles", "rig.crosshead_speed"),
        ("cycles: 3", "cycles: 3, stroke: 53 m", "rig.stroke"),
        ("counterweight: 2.7 g", "counterweight: 2700 kg", "rig.string.counterweight"),
        ("grip_offset: 6 mm", "grip_offset: -6 m", "markers.grip_offset"),
        ("{length: 85 mm}", "{section: {wall: 3 m}}", "specimen.section.wall"),
        ("{length: 85 mm}", "{section: {area: 5 m^2}}", "specimen.section.area"),
        ("{length: 85 mm}", "{section: {width: 18 m}}", "specimen.section.width"),
    ],
)
def test_an_implausible_dimension_of_a_protocol_is_refused(
    told: Told, old: str, new: str, place: str
) -> None:
    (message,) = told((old, new))

    assert f"({place}): expected a plausible " in message


@pytest.mark.parametrize("ends", ["{from: 1 mm, to: 100 km}", "{to: 100 km}"])
def test_a_test_or_a_protocol_widens_a_range(resolved: Resolved, ends: str) -> None:
    long = SHEET.replace(LENGTH, "length: 100 km")
    own = resolved(f"plausible.length: {{value: {ends}, because: x}}", sheet=long)
    assert own.specimen.length == 1e5
    assert own.plausible["length"].start == "1 mm"
    assert own.plausible["span"].stop == PLAUSIBLE["span"][2]
    assert parse_protocol(dump_protocol(own), "result.h5") == own

    change = ("version: 1\n", f"version: 1\nplausible: {{length: {ends}}}\n")
    assert resolved(sheet=long, change=change).specimen.length == 1e5


@pytest.mark.parametrize(
    ("written", "place", "expected"),
    [
        ("{length: {to: 5}}", "plausible.length.to", "a quantity with a unit such as m"),
        ("{speed: {to: 5 m}}", "plausible.speed.to", "a quantity with a unit such as m/s"),
        ("{length: {from: 2 m, to: 1 m}}", "plausible.length", "'from' of at least zero"),
        ("{length: 5 m}", "plausible.length", "a block of keys"),
        ("{lenght: {from: 1 m, to: 5 m}}", "plausible.lenght", "'length'"),
        ("{length: {to: [5 m]}}", "plausible.length.to", "text"),
        ("{length: {most: 5 m}}", "plausible.length.most", "one of the keys"),
    ],
)
def test_a_wrong_range_is_refused(told: Told, written: str, place: str, expected: str) -> None:
    (message,) = told(("report:\n", f"plausible: {written}\nreport:\n"))

    assert f"({place})" in message
    assert expected in message


HARNESS = """\
version: 1
line: {length: 300 mm, section: {bending_stiffness: 1 N*mm^2, torsional_stiffness: 1 N*mm^2,
  largest_curvature: 20 1/m, diameter: 2 mm}}
boundaries:
  - {kind: clip, name: left, at: start, position: [0 mm, 0 mm, 0 mm], direction: [1, 0, 0]}
"""


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("length: 300 mm", "length: 300 m", "line.length"),
        ("diameter: 2 mm", "diameter: 2 m", "line.section.diameter"),
        ("boundaries:", "sweep: {length: [310 mm, 320 m]}\nboundaries:", "sweep.length.1"),
    ],
)
def test_a_harness_has_plausible_dimensions_too(
    tmp_path: Path, old: str, new: str, key: str
) -> None:
    path = tmp_path / "harness.yaml"
    path.write_text(HARNESS.replace(old, new), encoding="utf-8")
    with pytest.raises(ProtocolError) as info:
        load_harness(path)
    assert f"({key}): expected a plausible " in str(info.value)

    widened = str(info.value).partition("write '")[2].partition("'")[0]
    path.write_text(f"{HARNESS.replace(old, new)}{widened}\n", encoding="utf-8")
    load_harness(path)


CERTIFICATE = "{number: LC-7 / 2026, date: 2026-01-10, due: 2027-01-10, uncertainty: 0.5 %}"


FORCE = "unit: V\n"
"""Where a key of the channel of the force can be added."""


def with_certificate(wire: str, certificate: str) -> str:
    calibrated = wire.replace(", gain_uncertainty: 0.2 %", "")
    return calibrated.replace(FORCE, f"{FORCE}    certificate: {certificate}\n")


def kept(protocol: Protocol) -> Protocol:
    """The same, written and read again."""
    again = parse_protocol(dump_protocol(protocol), "again.yaml")
    assert again == protocol
    return again


@pytest.mark.parametrize(
    ("stated", "standard"),
    [("0.5 %", 0.0025), ("0.5 %, k: 1", 0.005), ("0.6 %, k: 3", 0.002), ("0 %", 0.0)],
)
def test_a_certificate_states_k_times_the_standard_uncertainty(
    wire: str, stated: str, standard: float
) -> None:
    text = with_certificate(wire, CERTIFICATE.replace("0.5 %", stated))
    force = kept(parse_protocol(text, "p.yaml")).channels["force"]
    assert force.gain_uncertainty == pytest.approx(standard, rel=1e-12)
    assert force.certificate is not None
    assert force.certificate.number == "LC-7 / 2026"
    assert (force.certificate.date, force.certificate.due) == (date(2026, 1, 10), date(2027, 1, 10))


def test_a_certificate_that_says_the_same_as_the_calibration(wire: str) -> None:
    """0.2 % of the gain and 0.15 % of the scale make 0.25 %, which is 0.5 % with k = 2."""
    more = f"{FORCE}    scale_uncertainty: 0.15 %\n    certificate: {CERTIFICATE}\n"
    force = parse_protocol(wire.replace(FORCE, more), "p.yaml").channels["force"]
    assert force.gain_uncertainty == pytest.approx(0.0025)


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
    cameras = kept(parse_protocol(text, "p.yaml")).sources["markers"]
    assert cameras.camera_uncertainty == pytest.approx(standard)
    assert cameras.all_channels == {}


def test_the_zero_of_a_force_drifts(wire: str, tube: str) -> None:
    """Of one channel named like its role, and of one of several; 0 is stated, too."""
    drifting = wire.replace(FORCE, f"{FORCE}    zero_drift: 0.12 %\n")
    assert kept(parse_protocol(drifting, "p.yaml")).channels["force"].zero_drift == 0.0012
    assert kept(parse_protocol(wire, "p.yaml")).channels["force"].zero_drift is None
    frame = tube.replace("force: {", "force: {zero_drift: 0, ", 1)
    channels = kept(parse_protocol(frame, "p.yaml")).channels
    assert (channels["force"].zero_drift, channels["displacement"].zero_drift) == (0.0, None)


def test_sizes_have_uncertainties(tube: str) -> None:
    sizes = "thickness: 0.3 mm}, uncertainty: {length: 0.5 mm, thickness: 6 um, area: 0.05 mm^2}}"
    specimen = kept(parse_protocol(tube.replace("thickness: 0.3 mm}}", sizes), "p.yaml")).specimen
    assert specimen.uncertainty is not None
    assert specimen.uncertainty.stated == pytest.approx(
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
    assert specimen.uncertainty.stated == {"length": 0.001, "wall": 1e-6}
