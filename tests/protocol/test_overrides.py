"""What a test changes in its protocol, leaves out of it, and may not do."""

from __future__ import annotations

import os
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


def test_a_result_that_others_are_made_of_stays(
    lab: Path, tube: str, write: Callable[[str], Path]
) -> None:
    gone = "results.stiffness_first: {value: null, because: x}"
    with pytest.raises(ProtocolError, match=r"\(results\.3\.of\): expected one of the stiffnesses"):
        tube_of(lab, tube, write, gone)


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


@pytest.mark.parametrize("roles", [["force"], ["force", "frame"], ["force", "markers"]])
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


@pytest.fixture
def tell_of_conduit(tmp_path: Path) -> Callable[..., str]:
    """Give the error of a test with some files and a changed protocol."""

    def tell_of_conduit(files: str, *changes: tuple[str, str]) -> str:
        text = CONDUIT.read_text(encoding="utf-8")
        for old, new in changes:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        folder = tmp_path / "protocols"
        folder.mkdir()
        (folder / "conduit-bundle.yaml").write_text(text, encoding="utf-8")
        path = tmp_path / "test.yaml"
        path.write_text(CONDUIT_SHEET % files, encoding="utf-8")
        with pytest.raises(ProtocolError) as info:
            resolve(load_test_sheet(path), path, folder)
        return str(info.value).replace(f"{tmp_path}{os.sep}", "")

    return tell_of_conduit


def test_neither_frame_nor_speed(tell_of_conduit: Callable[..., str]) -> None:
    found = tell_of_conduit("force: a.mat", ("crosshead_speed: 0.5 mm/s, ", ""))

    assert found.partition(": ")[2] == (
        "expected a file in the role 'frame', or 'rig.crosshead_speed' to make 'displacement' from,"
        " found neither. Add the file to 'files', or 'rig.crosshead_speed' to the protocol."
    )


def test_a_source_that_is_not_optional_is_still_needed(tell_of_conduit: Callable[..., str]) -> None:
    found = tell_of_conduit("frame: a.txt")

    assert found.partition(": ")[2] == (
        "expected a file in the role 'force', found none. Add it to 'files'."
    )


def test_a_step_without_speed_where_no_source_measures(whole: Protocol) -> None:
    text = dump_protocol(without_absent(whole, ["force"]))
    lines = [line for line in text.splitlines() if "crosshead_speed" not in line]

    with pytest.raises(ProtocolError) as info:
        parse_protocol("\n".join(lines), "p.yaml")

    assert (
        "expected 'rig.crosshead_speed' for 'travel-from-speed', found none. Add "
        "'rig.crosshead_speed', or a source that measures the displacement."
    ) in str(info.value)


LINKED_SHEET = """\
test: A1
protocol: own
specimen: {type: A, spool: s, sample: 1}
files: {force: force.mat}
"""


PROTOCOL = "version: 1\nname: own\nsources: {force: {reader: dspace-mat, channel: x, unit: N}}\n"


Resolve = Callable[..., str]


@pytest.fixture
def linked_lab(tmp_path: Path) -> Path:
    """A linked_lab whose test has a link into a store."""
    for folder in ("protocols", "test", "store"):
        (tmp_path / folder).mkdir()
    (tmp_path / "store" / "001.mat").write_bytes(b"synthetic")
    (tmp_path / "test" / "force.mat").symlink_to(tmp_path / "store" / "001.mat")
    return tmp_path


@pytest.fixture
def refusal(linked_lab: Path) -> Resolve:
    """Why a test is refused; empty if it is not."""

    def refusal(*, follow_links: bool = False, protocol: str = "", sheet: str = "") -> str:
        (linked_lab / "protocols" / "own.yaml").write_text(PROTOCOL + protocol, encoding="utf-8")
        path = linked_lab / "test" / "test.yaml"
        path.write_text(LINKED_SHEET + sheet, encoding="utf-8")
        try:
            resolve(
                load_test_sheet(path), path, linked_lab / "protocols", follow_links=follow_links
            )
        except ProtocolError as error:
            return str(error)
        return ""

    return refusal


def test_a_link_out_of_the_folder_is_refused(linked_lab: Path, refusal: Resolve) -> None:
    place, _, said = refusal().partition(" (files.force): expected ")
    assert place == f"{linked_lab / 'test' / 'test.yaml'}, line 4, column 16"
    assert said.startswith("a file inside the folder of the test, found 'force.mat', a link out of")


def test_a_link_is_followed_where_the_command_says_so(refusal: Resolve) -> None:
    assert refusal(follow_links=True) == ""


@pytest.mark.parametrize("word", ["true", "True"])
def test_a_link_is_followed_where_the_protocol_says_so(refusal: Resolve, word: str) -> None:
    assert refusal(protocol=f"follow_links: {word}\n") == ""
    assert "a link out of it" in refusal(protocol="follow_links: false\n")


def test_a_test_cannot_say_so_itself(refusal: Resolve) -> None:
    change = "overrides: {follow_links: {value: true, because: x}}\n"
    message = refusal(sheet=change)
    assert "a link out of it" in message
    assert (
        "line 5, column 13 (overrides.follow_links): expected a key that a test may change, found"
        " 'follow_links'. Write it into the protocol, or give --follow-links."
    ) in message


def test_a_link_within_the_folder(linked_lab: Path, refusal: Resolve) -> None:
    (linked_lab / "test" / "force.mat").rename(linked_lab / "test" / "other.mat")
    (linked_lab / "test" / "first.mat").write_bytes(b"synthetic")
    (linked_lab / "test" / "force.mat").symlink_to(linked_lab / "test" / "first.mat")
    assert refusal() == ""


@pytest.mark.parametrize("follow_links", [True, False])
def test_a_link_that_leads_back_to_itself(
    linked_lab: Path, refusal: Resolve, follow_links: bool
) -> None:
    (linked_lab / "test" / "force.mat").unlink()
    (linked_lab / "test" / "force.mat").symlink_to(linked_lab / "test" / "force.mat")
    assert refusal(follow_links=follow_links).endswith(
        "expected a file, found 'force.mat', a link that leads back to itself. Make the link anew."
    )


@pytest.mark.parametrize("name", ["../store/001.mat", "/etc/hostname"])
def test_a_path_that_leaves_the_folder_is_never_followed(
    refusal: Resolve, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(globals(), "LINKED_SHEET", LINKED_SHEET.replace("force.mat", name))
    assert "expected a file inside the folder of the test" in refusal(follow_links=True)


LENGTH = "length: 80 mm"


OVERRIDES = "overrides:\n  {}: {{value: {}, because: x}}\n"


@pytest.mark.parametrize(
    ("written", "key", "wider"),
    [
        ("length: 100 km", "specimen.length", "plausible.length.to: {value: 100 km"),
        ("length: 80 m", "specimen.length", "plausible.length.to: {value: 80 m"),
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
    assert "overrides" in rest


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


@pytest.mark.parametrize("ends", ["{from: 1 mm, to: 100 km}", "{to: 100 km}", "{to: 2000 km}"])
def test_a_test_or_a_protocol_widens_a_range(
    lab: Path, wire: str, write: Callable[[str], Path], ends: str
) -> None:
    long = SHEET.replace(LENGTH, "length: 100 km")
    path = write(long + OVERRIDES.format("plausible.length", ends))
    own = resolve(load_test_sheet(path), path, lab / "protocols")
    assert own.specimen.length == 1e5
    assert own.plausible["length"].start == "1 mm"
    assert own.plausible["span"].stop == PLAUSIBLE["span"][2]
    assert parse_protocol(dump_protocol(own), "result.h5") == own

    file = lab / "protocols" / "wire.yaml"
    file.write_text(f"{wire}plausible: {{length: {ends}}}\n", encoding="utf-8")
    path = write(long)
    assert resolve(load_test_sheet(path), path, lab / "protocols").specimen.length == 1e5


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
    ("said", "standard"),
    [("0.5 %", 0.0025), ("0.5 %, k: 1", 0.005), ("0.6 %, k: 3", 0.002), ("0 %", 0.0)],
)
def test_a_certificate_states_k_times_the_standard_uncertainty(
    wire: str, said: str, standard: float
) -> None:
    text = with_certificate(wire, CERTIFICATE.replace("0.5 %", said))
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
    ("said", "standard"),
    [
        ("", 0.0),
        ("    scale_uncertainty: 0.05 %\n", 0.0005),
        (f"    certificate: {CERTIFICATE}\n", 0.0025),
        (f"    scale_uncertainty: 0.25 %\n    certificate: {CERTIFICATE}\n", 0.0025),
    ],
)
def test_cameras_have_a_scale(wire: str, said: str, standard: float) -> None:
    text = wire.replace("reader: motive-csv\n", f"reader: motive-csv\n{said}")
    cameras = kept(parse_protocol(text, "p.yaml")).sources["markers"]
    assert cameras.camera_uncertainty == pytest.approx(standard)
    assert cameras.all_channels == {}


def test_the_zero_of_a_force_drifts(wire: str, tube: str) -> None:
    """Of one channel named like its role, and of one of several; 0 is stated, too."""
    said = wire.replace(FORCE, f"{FORCE}    zero_drift: 0.12 %\n")
    assert kept(parse_protocol(said, "p.yaml")).channels["force"].zero_drift == 0.0012
    assert kept(parse_protocol(wire, "p.yaml")).channels["force"].zero_drift is None
    frame = tube.replace("force: {", "force: {zero_drift: 0, ", 1)
    channels = kept(parse_protocol(frame, "p.yaml")).channels
    assert (channels["force"].zero_drift, channels["displacement"].zero_drift) == (0.0, None)


def test_sizes_have_uncertainties(tube: str) -> None:
    said = "thickness: 0.3 mm}, uncertainty: {length: 0.5 mm, thickness: 6 um, area: 0.05 mm^2}}"
    specimen = kept(parse_protocol(tube.replace("thickness: 0.3 mm}}", said), "p.yaml")).specimen
    assert specimen.uncertainty is not None
    assert specimen.uncertainty.stated == pytest.approx(
        {"length": 5e-4, "thickness": 6e-6, "area": 5e-8}
    )


@pytest.mark.parametrize(
    ("sheet", "overrides"),
    [
        (", uncertainty: {length: 1 mm}", ""),
        ("", "overrides:\n  specimen.uncertainty.length: {value: 1 mm, because: bent}\n"),
    ],
)
def test_a_test_has_uncertainties_of_its_own(
    sheet: str, overrides: str, lab: Path, wire: str, write: Callable[[str], Path]
) -> None:
    text = wire.replace(
        "{length: 85 mm}", "{length: 85 mm, uncertainty: {length: 2 mm, wall: 1 um}}"
    )
    (lab / "protocols" / "wire.yaml").write_text(text, encoding="utf-8")
    path = write(SHEET.replace("length: 80 mm", f"length: 80 mm{sheet}") + overrides)

    found = resolve(load_test_sheet(path), path, lab / "protocols").specimen.uncertainty

    assert found is not None
    assert found.stated == {"length": 0.001, "wall": 1e-6}


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


def test_neither_frame_nor_a_step_that_makes_the_displacement(
    tell_of_conduit: Callable[..., str],
) -> None:
    text = CONDUIT.read_text(encoding="utf-8")
    step = next(line for line in text.splitlines() if "travel-from-speed" in line)

    found = tell_of_conduit("force: a.mat", (f"{step}\n", ""))

    assert found.partition(": ")[2] == (
        "expected a file in the role 'frame', which gives 'displacement', found none. Add it to "
        "'files', or add the step 'travel-from-speed' to the protocol."
    )
