"""What is refused in protocols, test sheets, plans and harness files: each message once."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable
from math import cos, pi, sin
from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from labpipe.errors import ProtocolError
from labpipe.protocol.grammar import validated
from labpipe.protocol.load import (
    checked,
    load_calibration_plan,
    load_campaign_plan,
    load_harness,
    parse_protocol,
)
from labpipe.protocol.sheet_grammar import TestSheet
from labpipe.protocol.values import FileStem, Line, Text
from labpipe.protocol.yaml_text import parse_yaml
from labpipe.records.declarations import (
    Compliance,
    Force,
    Length,
    Mass,
    Offset,
    Ratio,
    Share,
    Snake,
    Span,
)
from tests.approved import Approve
from tests.protocol.conftest import SHEET, TUBE, WIRE, Tell
from tests.protocol.test_harness_file import BETWEEN_CLIPS, WHOLE
from tests.protocol.test_plans import BY_NAME

Change = tuple[str, str]


def instead(old: str, *texts: str) -> list[Change]:
    """Several texts in the place of one."""
    return [(old, text) for text in texts]


def added(line: str, *more: str) -> list[Change]:
    """Several lines, each below one that is there."""
    return [(f"{line}\n", f"{line}\n{text}\n") for text in more]


def removed(*texts: str) -> list[Change]:
    return [(text, "") for text in texts]


SEVEN = "wires: {B1: {number: 4, diameter: 1.6 mm}, B2: {number: 3, diameter: 1.6 mm}}\n"
HEXAGON = [(0.0, 0.0), *((cos(k * pi / 3), sin(k * pi / 3)) for k in range(6))]
CLOSE = ", ".join(f"[{1.58 * x:.6f} mm, {1.58 * y:.6f} mm]" for x, y in HEXAGON)
LAW = ("results:\n", "results:\n  - {result: moment-curvature, at: 5 1/m}\n")
NO_SHAPE = ("  - {step: fit-shape, terms: 7, tip: free}\n", "")
FRAME = "  - {step: specimen-frame, over: 2 s}\n"
CAMERAS = "  markers:\n    reader: motive-csv\n"
CALIBRATION = "    calibration: {gain: 0.5 N/V, offset: 0 N, gain_uncertainty: 0.2 %}\n"
BRANCHES = "branches: {channel: travel, min_stroke: 5 mm}\n"
WINDOW = "  - {result: stiffness, from: 0 mm, to: 1 mm}\n"
CERTIFICATE = "certificate: {number: LC-7 / 2026, date: 2026-01-10, uncertainty: 0.5 %}"
OF_A_LENGTH = "bending-stiffness, of: initial_stiffness, support: cantilever"


TOGETHER = [
    (("span: 0.1 s", "span: 5 %"), (BRANCHES, "")),
    (
        ("result: peak-force", "result: tip-travel"),
        NO_SHAPE,
        ("method: turning-points", "method: none"),
        ("wire-shapes", "marker-quality"),
        (CAMERAS, ""),
    ),
    (LAW, ("clamp: Clamp", "clamp: null")),
    (LAW, NO_SHAPE, ("displacement: deflection", "displacement: force")),
    (
        ("to: 4 mm}\n", f"to: 4 mm}}\n  - {{result: {OF_A_LENGTH}, length_uncertainty: 1 mm}}\n"),
        ("{length: 85 mm}", "{length: 85 mm, uncertainty: {length: 2 mm}}"),
    ),
]
"""Several changes of the protocol of a wire."""


OF_A_SHEET = [
    ("length: 80 mm", "length: 80 mm, uncertainty: {length: 90 mm}"),
    ("markers: [take.csv]", "frame: a.csv"),
    ("protocol: wire", "protocol: wirre"),
]


WIRE_FAULTS = [
    *added(
        "    reader: motive-csv",
        "  frame: {reader: dspace-mat, channels: {load: {channel: x}}}",
        "  frame: {reader: dspace-mat, channels: {force: {channel: x}}}",
        "  frame: {reader: dspace-mat, channels: {travel: {channel: x}}}",
    ),
    ("- {result: clock}", "- {result: normalised-stiffness}"),
    *instead("wire-shapes", "moment-curvature", "wire-shape", "wire-shapes, wire-shapes"),
    ("zero, channel: force", "zero, channel: forse"),
    *added("steps:", "  - {step: zero, channel: travel, over: 1 s}"),
    ("turning-points, channel: force", "turning-points, channel: forc"),
    *instead("displacement: deflection", "displacement: deflexion"),
    ("displacement: deflection", "displacement: deflection, reverse: [displacement]"),
    ("branches: {channel: travel", "branches: {channel: trawel"),
    ("curve: {force: force", "curve: {force: travel"),
    ("method: turning-points", "method: none"),
    *instead("clamp: Clamp, ", "clamp: null, ", ""),
    *removed("markers: {clamp: Clamp, along: all, grip_offset: 6 mm}\n", CAMERAS),
    (FRAME, FRAME + FRAME),
    *removed(FRAME, BRANCHES, "curve: {force: force, displacement: deflection}\n"),
    NO_SHAPE,
    *added("  - {result: clock}", "  - {result: clock}", f"{WINDOW}{WINDOW}"),
    *instead("{displacement: mm,", "{displacment: mm,", "{displacement: mN,"),
    *instead("gain: 0.5 N/V", "gain: 0.5 mm/V", "gain: 0.5", "gain: 0 N/V"),
    ("offset: 0 N", "offset: 0 V"),
    *removed("    unit: V\n", CALIBRATION, "    channel: Model Root/Load/Out1\n", "name: wire\n"),
    (f"    unit: V\n{CALIBRATION}", "    wrong_unit_in_file: kN\n"),
    ("unit: V\n", "unit: Volts per N\n"),
    *added("    reader: motive-csv", "    channel: x"),
    ("    reader: motive-csv\n", "    reader: dspace-mat\n"),
    *instead("[dspace-mat, dspace-csv]", "motive-csv", "[dspace-mta, dspace-csv]", "[]"),
    ("version: 1", "version: 2"),
    ("results:\n", "resluts:\n"),
    ("  markers:\n", "  marker:\n"),
    ("step: smooth", "step: smoth"),
    ("{step: zero,", "{"),
    ("to: 4 mm", "to: 0.5 mm"),
    ("crosshead_speed: 1 mm/s", "crosshead_speed: 0 mm/s"),
    ("max_gap: 0.5 s", "max_gap: 0.5"),
    ("cycles: 3", "cycles: three"),
    ("along: all", "along: []"),
    ("gain_uncertainty: 0.2 %", "gain_uncertainty: -0.2 %"),
    ("grip_offset: 6 mm", "centre_uncertainty: -1 mm"),
    *instead(
        "length: 85 mm",
        "length: 85 mm, uncertainty: {length: 85 mm}",
        "section: {area: 5 mm^2}, uncertainty: {area: 0.1 cm^2}",
        "uncertainty: {lenght: 1 mm}",
    ),
    *added(
        "    unit: V",
        "    channels: {load: {channel: x, quantity: force}}",
        "    quantity: forse",
        "    scale_uncertainty: 2.5",
        "    zero_drift: 101 %",
        f"    {CERTIFICATE}",
        "    certificate: {number: 7, date: 2026-01-10, due: 2025-01-10}",
        "    certificate: {number: 7, date: 2026-01-10, due: 2026-01-10}",
        "    certificate: {number: 7, date: January, due: 2025-01-10}",
        "    certificate: {number: 7, date: 2026-01-10, k: 0.5}",
        "    certificate: {date: 2026-01-10}",
    ),
    *added("    reader: motive-csv", f"    scale_uncertainty: 1 %\n    {CERTIFICATE}"),
]


STIFFNESS = "  - {result: stiffness, name: stiffness_first, from: 2 mm, to: 8 mm}\n"
SEGMENTS = "  - {result: two-segments, from: 2 mm, to: 20 mm}\n"
PEAK = "plausible_peak: {from: 20 N, to: 2 kN}"
TUBE_FAULTS = [
    *removed(
        TUBE[TUBE.index("curve:") : TUBE.index("branches:")],
        TUBE[TUBE.index("results:") : TUBE.index("report:")],
        STIFFNESS + SEGMENTS,
        "  failure: {force_below: 50 %}\n",
        "  slack: {from: 10 %, to: 30 %}\n",
        "branches: {channel: displacement, min_stroke: 5 mm}\n",
    ),
    ("displacement: {", "displacement: {zero_drift: 1 %, "),
    ("normalised-stiffness, of: stiffness_first", "normalised-stiffness, of: stifness_first"),
    ("of: segment_stiffness_first", "of: break_point"),
    *added(
        "  - {result: slack}",
        "  - {result: slack}",
        "  - {result: modulus, of: stiffness_first, area: annulus}",
        "  - {result: normalised-stiffness, of: stiffness_first}",
        "  - {result: stiffness, name: failure_force, from: 0 mm, to: 1 mm}",
    ),
    (SEGMENTS, f"  - {{result: stiffness, name: break_point, from: 0 mm, to: 1 mm}}\n{SEGMENTS}"),
    ("{decision: marked, min_drop: 2 N}", "null"),
    ("decision: marked", "decision: mark"),
    ("main: [stiffness_first,", "main: [stifness_first,"),
    ("peak_force.2]", "peak_force]"),
    *instead(
        PEAK,
        "quantity: forse, plausible_peak: {from: 3, to: 2}",
        *("plausible_peak: {from: 20 N, to: 2 mm}", "plausible_peak: {from: 20 N, to: 20 N}"),
        *("plausible_peak: {from: -1 N, to: 20 N}", "plausible_peak: {from: 20 N}"),
    ),
    *added("    part: Specimen 1", "    plausible_peak: {from: 1 N, to: 2 N}"),
    *instead("reader: load-frame", "reader: dspace-csv", "reader: [dspace-csv, dspace-mat]"),
    ("dialect: [mts-testsuite, table]", "dialect: []"),
    *instead("[Load, Force]", "[]", "null", "[Load, {a: b}]"),
    ("by: line", "by: slope"),
    ("to: 20 mm", "to: 1 mm"),
    ("to: 400 N", "to: 50 N"),
    ("{from: 10 %, to: 30 %}", "{from: 30 %, to: 10 %}"),
    ("force_below: 50 %", "force_below: 150 %"),
    ("value: 0.2 um/N", "value: 0.2 um"),
    *instead("area: rectangle", "area: rectangel", "area: rectangle, name: E"),
    *removed(", area: rectangle"),
    ("margin: 10 %", "margin: 1 mm"),
    ("scaled: true", "scaled: perhaps"),
]


TAPED = """\
wires: {B1: 10, B2: {number: 9, diameter: 1.6 mm}}
number: 19
arrangement: asymmetric
tape: PVC
taping: half-lap
conduit: corrugated-tube
conduit_bore: 10.7 mm
"""
OF_TAPED = [
    *(("19", "18"), ("number: 19", "number: many"), ("asymmetric", "asymetric")),
    *(("half-lap", "halflap"), ("B1: 10", "B1: ten"), ("1.6 mm", "1.6"), ("diameter", "diametr")),
]
BUNDLE_FAULTS = [
    *(TAPED.replace(old, new) for old, new in OF_TAPED),
    "wires: [B1, B2]",
    "wires: {}",
    "wires: 10 B1, 9 B2",
    "wires: 10 B1 + nine B2",
    "wires: B1",
    "wires: 10 B1 + 9 B1",
    "wires: {B1: 7}\narrangement: symmetric",
    f"{SEVEN}positions: [[0 mm, 0 mm], [2 mm, 0 mm]]",
    f"{SEVEN}positions: [{CLOSE}]",
    "wires: {B1: 1}\npositions: [[0 mm, 0 mm]]",
    "wires: {B1: 1}\npositions: [[0 mm, 0 mm, 0 mm]]",
    "wires: {B1: 1}\npositions: [0 mm]",
    "wires: {B1: 1}\npositions: [[0 mm, 1]]",
    "wires: {B1: 7}\ntaping: coarse",
    "wires: {B1: 7}\ntape: PET",
    "wires: {B1: 7}\nconduit_bore: 10.7 mm",
    f"{SEVEN}conduit: tube\nconduit_bore: 4.4 mm",
    "wires: {B1: {number: 1, diameter: 3 mm}}\nconduit: tube\nconduit_bore: 2.9 mm",
    "tape: none",
]


SHEET_FAULTS = [
    *instead("force.mat", "[a.mat, ../b.mat]", "' '"),
    ("{force: force.mat}", "{}"),
    ("{force: ", "{forse: "),
    ("length: 80", "lenght: 80"),
    ("width:", "Width:"),
    ("spool: A2-s1", "spol: A2-s1"),
    *instead("width: 2 mm", "colour: red", "weight: 3 g", "width: 2", "bundle: 7 B1"),
    *instead("width: 2 mm", "labels: {Cured: 24 h}", "labels: {spool: s2}"),
    *instead("width: 2 mm", "labels: [cured]", "labels: {cured: }"),
    *added("protocol: wire", "date: 4.3.2026", "overrides: {a.b: {value: 1}}"),
]


HARNESS_FAULTS = [
    *instead("length: 0.3 m", "length: 0.3", "length: 0.3 N"),
    ("elements: 30", "elements: 3"),
    *removed("    diameter: 2.2 mm\n", "    largest_curvature: 80 1/m\n"),
    *removed("    bending_stiffness: 150 N*mm^2\n"),
    ("    bending_stiffness: 150 N*mm^2", "    wire: A2\n    bending_stiffness: 150 N*mm^2"),
    ("    mass_per_length: 7 g/m", "    sheet: wires.xlsx"),
    ("at: start", "at: begin"),
    *instead("[3, 0, 4]", "[0, 0, 0]", "[3, 0]", "right"),
    ("kind: grip", "kind: gripp"),
    ("name: stud", "name: left"),
    *instead("at: 200 mm\n", "at: start\n", "at: 200 mm\n    holds: position\n"),
    ("at: end", "at: 0.2 m"),
    *instead("step: 20", "step: 10", "step: 31"),
    ("release: 25", "release: 31"),
    ("by: 5", "by: 50"),
    ("[10, 20]", "[10, 40]"),
    ("friction: 0.3", "friction: -1"),
    ("steps: 30", "stpes: 30"),
    ("[310 mm, 320 mm]", "[310 mm]"),
]


RIGHT = "kind: clip, name: right, at: end, position: [10 mm, 250 mm, 0 mm]"
RAISED, LOWERED = "position: [10 mm, 250 mm, 0 mm]", "position: [10 mm, 240 mm, 0 mm]"
MID = (
    "kind: grip, name: mid, at: 100 mm, path: [{step: 5, position: [0 mm, 90 mm, 0 mm]},"
    " {step: 15, position: [0 mm, 30 mm, 99 mm]}], release: 20"
)
TURNED = f"{{step: 4, turn: 90 deg}}, {{step: 6, {RAISED}}}, {{step: 7, turn: -100 deg}}"
THREAD = "kind: string, name: thread, at: 100 mm, length: 50 mm, anchor: [0 mm, 0 mm, 200 mm]"
GUIDE = "kind: ring, name: guide, position: [0 mm, 100 mm, 120 mm], direction: [0, 1, 0]"
TABLE = "kind: plane, name: table, point: [0 mm, 0 mm, -1 mm], normal: [0, 0, 5]"
REACH_FAULTS = [
    ("250 mm", "301 mm"),
    ("at: end", "at: 310 mm"),
    (RIGHT, f"{MID}}}\n  - {{by: 10, {RIGHT.replace('250', '150')}"),
    ("    diameter", "    diameter: 2.2 mm\nsweep: {length: [400 mm, 240 mm, 200 mm]}\n#"),
    *added("boundaries:", f"  - {{{THREAD}}}", f"  - {{{GUIDE}}}", f"  - {{{TABLE}}}"),
    (RIGHT, f"{RIGHT}, turn: 540 deg, by: 3"),
    (RIGHT, f"kind: grip, name: right, at: end, path: [{TURNED}]"),
    (RIGHT, f"kind: pin, name: right, at: end, {RAISED}, by: 9, release: 9"),
    (
        RIGHT,
        "kind: grip, name: right, at: end, release: 4,"
        f" path: [{{step: 6, {RAISED}}}, {{step: 9, {LOWERED}}}]",
    ),
    ("  section:", "  spool: {curvature: 500 1/m}\n  section:"),
    ("bending_stiffness: 150 N*mm^2", "sliders: none.sliders.json\n#"),
]


CALIBRATION_PLAN = """\
version: 1
parameters:
  insulation_modulus: {}
comparisons:
  - {name: fe, file: fe.csv, wire: A2, length: 85 mm, because: a model of solid elements}
"""
CALIBRATION_FAULTS = [
    *instead(
        "modulus: {}",
        "modulus: {enters: prior, factor: 1.5, because: x}",
        "modulus: {enters: fixed, because: x}",
        "modulus: {enters: fixed, value: 1 GPa}",
        "modulus: {enters: prior, value: 1 GPa, because: x}",
        "modulus: {factor: 1.5}",
        "modulus: {enters: guessed}",
        "modulus: {value: 1000}",
        "modulus: {enters: prior, value: 1 GPa, factor: 0.5, because: x}",
    ),
    *instead("fe.csv", "../fe.csv", "/fe.csv", "C:\\fe.csv", "' '"),
    ("length: 85 mm", "length: 85"),
    ("a model of solid elements", "''"),
    *instead(
        "wire: A2",
        "wire: A2, load: upward",
        "wire: A2, deflection: {unit: N}",
        "wire: A2, force: {unit: mm}",
        "wire: A2, force: {sign: 2}",
        "wire: A2, force: {colum: 2}",
    ),
    *removed("name: fe, ", "file: fe.csv, ", "wire: A2, ", "length: 85 mm, "),
    *removed(", because: a model of solid elements"),
    *added(
        "comparisons:",
        "  - {name: fe, file: fe.csv, wire: A2, length: 85 mm, because: the same again}",
    ),
]


OVERRIDE_FAULTS = [
    "sources.force.calibration.gain: {value: 0.0411 N, because: x}",
    "rig.strok: {value: 3 mm, because: x}",
    "rigg.stroke: {value: 3 mm, because: x}",
    "rig.cycles.x: {value: 3, because: x}",
    "steps.smoth.span: {value: 1 s, because: x}",
    "steps.9.span: {value: 1 s, because: x}",
    "results: {value: [{result: clock}, {result: enrgy}], because: x}",
    "markers.clamp: {value: null, because: x}",
    "specimen.length: {value: 3 mm, because: x}",
]


VALUE_FAULTS: list[tuple[Any, tuple[object, ...]]] = [
    (Text, (True, "")),
    (FileStem, ("a/b", "nul.1")),
    (Line, ("A\x072", "\ud800", "A2\n")),
    (Snake, ("Force",)),
    (Length, ("53", "53 s", "85 kg", "85 MM", "20 1/m", "0 mm", "-5 mm", None)),
    (Length, ("12,5 mm", "-0,125 mm", "1,000 mm", "1 000 mm", "1'000 mm")),
    (Length, ("1.000,5 mm", "1,000.5 mm", "1 000 000,25 mm")),
    (Force, ("5 kg", "500 g")),
    (Mass, ("-1 g", "5 N")),
    (Offset, ("1e400 mm",)),
    (Ratio, ("5 deg", "0,5", "0,5 %")),
    (Share, ("0 %", "110 %")),
    (Compliance, ("0.2 mm",)),
    (Span, ("51", "0 samples", "120 %", "0 s", "0,1 s", "0,1 mm", "1 kg")),
]


PLAN_FAULTS = [
    ("_force.mat", "_{forse}.mat"),
    *instead("{type}-{length mm}-{sample}.csv", "{type}-{length mm}.csv", "take.csv"),
    ("spool: A2-s1", "spol: A2-s1"),
    ("152.4 mm", "152.4"),
    (", because: set so", ""),
    ("still_for: 3 s", "still_for: 3"),
    ("by: name", "by: names"),
    ("operator:", "operater:"),
]


YAML_FAULTS = [
    "a: 1\nb: 2\na: 3\n",
    "a: !!python/object/new:os.system [ls]\n",
    "? [a, b]\n: c\n",
]


NO_YAML = [
    "a: [1, 2\nb: 3\n",
    "a: 1\n  b: 2\n",
    "a: 1\n\tb: 2\n",
    "a: &x 1\nb: *x\n",
    "a: 1\n---\nb: 2\n",
    "a: 1\nb: \x00\n",
    "[" * 5000,
]


CONDUIT_FAULTS = [
    ("method: common-start", "method: none"),
    *removed(
        "  - {step: three-point-shape, over: 2 s, section: 4 mm, facing: side}\n",
        "  - {step: repair-markers, max_gap: 0.5 s, max_jump: 4 mm, frozen: 0.2 s}\n",
    ),
    ("channel: displacement, force: force", "channel: displacement, force: forze"),
    ("cycles: 1", "cycles: 3"),
    ("    optional: true\n    reader: load-frame", "    reader: load-frame"),
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
        lines = [error["msg"].strip() for error in error.value.errors()]
    else:
        lines = str(error.value).splitlines()
    return "\n    ".join([repr(written)[1:-1], *(line.replace(os.sep, "/") for line in lines)])


@pytest.mark.parametrize(
    ("protocol", "cases"),
    [
        (WIRE, [*((case,) for case in WIRE_FAULTS), *TOGETHER]),
        (TUBE, [(case,) for case in TUBE_FAULTS]),
        (
            (Path(__file__).parents[2] / "protocols" / "conduit-bundle.yaml").read_text("utf-8"),
            [(case,) for case in CONDUIT_FAULTS],
        ),
    ],
    ids=["wire", "tube", "conduit"],
)
def test_protocols(protocol: str, cases: list[tuple[Change, ...]], approved: Approve) -> None:
    approved(
        refused(
            "; ".join(new or f"no {old}" for old, new in case),
            parse_protocol,
            changed(protocol, case),
            "p.yaml",
        )
        for case in cases
    )


def test_overrides(tell: Tell, approved: Approve) -> None:
    written = {line: f"{SHEET}overrides:\n  {line}\n" for line in OVERRIDE_FAULTS}
    written |= {new: changed(SHEET, [(old, new)]) for old, new in OF_A_SHEET}
    approved(
        "\n    ".join([line, *(message.replace(os.sep, "/") for message in tell(text))])
        for line, text in written.items()
    )


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
    sheets = {text: BUNDLE.format(text.strip().replace("\n", "\n    ")) for text in BUNDLE_FAULTS}
    sheets |= {new: changed(PLAIN, [(old, new)]) for old, new in SHEET_FAULTS}
    approved(refused(new, _sheet, text) for new, text in sheets.items())


def _sheet(text: str) -> object:
    return checked(TestSheet, parse_yaml(text, "x"))


def test_values(approved: Approve) -> None:
    approved(
        refused(str(text), _parse, kind, text) for kind, texts in VALUE_FAULTS for text in texts
    )


def _parse(kind: Any, text: object) -> object:
    return TypeAdapter(validated(kind)).validate_python(text)


def test_yaml(approved: Approve) -> None:
    messages = [str(fault.text) for text in YAML_FAULTS for fault in parse_yaml(text, "x").faults]
    assert len(messages) == len(YAML_FAULTS)
    approved(
        [
            *messages,
            *(refused(text[:40], parse_yaml, text, "x") for text in NO_YAML),
        ]
    )


@pytest.mark.parametrize(
    ("load", "text", "cases"),
    [
        (load_campaign_plan, BY_NAME, PLAN_FAULTS),
        (load_calibration_plan, CALIBRATION_PLAN, CALIBRATION_FAULTS),
        (load_harness, WHOLE, HARNESS_FAULTS),
        (load_harness, BETWEEN_CLIPS, REACH_FAULTS),
    ],
    ids=["campaign", "calibration", "harness", "reach"],
)
def test_plans(
    load: Callable[[Path], object],
    text: str,
    cases: list[Change],
    tmp_path: Path,
    approved: Approve,
) -> None:
    path, messages = tmp_path / "plan.yaml", []
    for old, new in cases:
        wrong = changed(text, [(old, new)])
        if "sliders" in new:
            wrong = re.sub(r"    (tor|lar).*\n", "", wrong)
        path.write_text(wrong, encoding="utf-8")
        messages.append(refused(new or f"no {old}", load, path))
    approved(message.replace(f"{tmp_path.as_posix()}/", "") for message in messages)
