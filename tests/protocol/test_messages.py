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
from labpipe.protocol.load import checked, load_campaign_plan, load_harness, parse_protocol
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

SEVEN = "wires: {B1: {number: 4, diameter: 1.6 mm}, B2: {number: 3, diameter: 1.6 mm}}\n"


HEXAGON = [(0.0, 0.0), *((cos(k * pi / 3), sin(k * pi / 3)) for k in range(6))]


CLOSE = ", ".join(f"[{1.58 * x:.6f} mm, {1.58 * y:.6f} mm]" for x, y in HEXAGON)


LAW = ("results:\n", "results:\n  - {result: moment-curvature, at: 5 1/m}\n")


NO_SHAPE = ("  - {step: fit-shape, terms: 7, tip: free}\n", "")


AFTER = "to: 4 mm}\n"


OF_A_LENGTH = (
    f"{AFTER}  - {{result: bending-stiffness, of: initial_stiffness, support: cantilever,"
    " length_uncertainty: 1 mm}\n"
)


TOGETHER = [
    (("span: 0.1 s", "span: 5 %"), ("branches: {channel: travel, min_stroke: 5 mm}", "")),
    (
        ("result: peak-force", "result: tip-travel"),
        NO_SHAPE,
        ("method: turning-points", "method: none"),
        ("wire-shapes", "marker-quality"),
        ("  markers:\n    reader: motive-csv\n", ""),
    ),
    (LAW, ("clamp: Clamp", "clamp: null")),
    (LAW, NO_SHAPE, ("displacement: deflection", "displacement: force")),
    (
        (AFTER, OF_A_LENGTH),
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
    (
        "  markers:\n",
        "  frame: {reader: dspace-mat, channels: {load: {channel: x}}}\n  markers:" + "\n",
    ),
    (
        "  markers:\n",
        "  frame: {reader: dspace-mat, channels: {force: {channel: x}}}\n  markers:" + "\n",
    ),
    (
        "  markers:\n",
        "  frame: {reader: dspace-mat, channels: {travel: {channel: x}}}\n  markers:" + "\n",
    ),
    ("- {result: clock}", "- {result: normalised-stiffness}"),
    ("wire-shapes", "moment-curvature"),
    ("zero, channel: force", "zero, channel: forse"),
    ("steps:\n", "steps:\n  - {step: zero, channel: travel, over: 1 s}\n"),
    ("turning-points, channel: force", "turning-points, channel: forc"),
    ("displacement: deflection", "displacement: deflexion"),
    ("branches: {channel: travel", "branches: {channel: trawel"),
    ("curve: {force: force", "curve: {force: travel"),
    ("displacement: deflection", "displacement: deflection, reverse: [displacement]"),
    (
        (
            "{method: turning-points, channel: force, motion_window: 25 s, "
            "force_window: 2 s,\n  max_residual: 5 ms, max_drift: 500 ppm}"
        ),
        "{method: none}",
    ),
    ("clamp: Clamp", "clamp: null"),
    ("markers: {clamp: Clamp, along: all, grip_offset: 6 mm}\n", ""),
    ("  markers:\n    reader: motive-csv\n", ""),
    (
        "  - {step: specimen-frame, over: 2 s}\n",
        "  - {step: specimen-frame, over: 2 s}\n  - {step: specimen-frame, over: 2 s}\n",
    ),
    ("  - {step: specimen-frame, over: 2 s}\n", ""),
    ("branches: {channel: travel, min_stroke: 5 mm}\n", ""),
    ("curve: {force: force, displacement: deflection}\n", ""),
    ("  - {step: fit-shape, terms: 7, tip: free}\n", ""),
    (
        "figures: [force-displacement, wire-shapes]",
        "figures: [force-displacement, wire-shapes, wire-shapes]",
    ),
    ("  - {result: clock}\n", "  - {result: clock}\n  - {result: clock}\n"),
    (
        "  - {result: clock}\n",
        (
            "  - {result: stiffness, from: 0 mm, to: 1 mm}\n  - {result: "
            "stiffness, from: 0 mm, to: 1 mm}\n"
        ),
    ),
    ("{displacement: mm,", "{displacment: mm,"),
    ("{displacement: mm,", "{displacement: mN,"),
    ("gain: 0.5 N/V", "gain: 0.5 mm/V"),
    ("gain: 0.5 N/V", "gain: 0.5"),
    ("gain: 0.5 N/V", "gain: 0 N/V"),
    ("offset: 0 N", "offset: 0 V"),
    ("    unit: V\n", ""),
    (
        ("    unit: V\n    calibration: {gain: 0.5 N/V, offset: 0 N, gain_uncertainty: 0.2 %}\n"),
        "    wrong_unit_in_file: kN\n",
    ),
    ("    unit: V\n", "    unit: Volts per N\n"),
    ("    calibration: {gain: 0.5 N/V, offset: 0 N, gain_uncertainty: 0.2 %}\n", ""),
    ("    unit: V\n", "    unit: V\n    channels: {load: {channel: x, quantity: force}}\n"),
    ("    channel: Model Root/Load/Out1\n", ""),
    ("    reader: motive-csv\n", "    reader: motive-csv\n    channel: x\n"),
    ("    reader: motive-csv\n", "    reader: dspace-mat\n"),
    ("[dspace-mat, dspace-csv]", "motive-csv"),
    ("    unit: V\n", "    unit: V\n    quantity: forse\n"),
    ("version: 1", "version: 2"),
    ("results:\n", "resluts:\n"),
    ("name: wire\n", ""),
    ("  markers:\n", "  marker:\n"),
    ("[dspace-mat,", "[dspace-mta,"),
    ("[dspace-mat, dspace-csv]", "[]"),
    ("step: smooth", "step: smoth"),
    ("{step: zero,", "{"),
    ("to: 4 mm", "to: 0.5 mm"),
    ("wire-shapes", "wire-shape"),
    ("crosshead_speed: 1 mm/s", "crosshead_speed: 0 mm/s"),
    ("max_gap: 0.5 s", "max_gap: 0.5"),
    ("cycles: 3", "cycles: three"),
    ("along: all", "along: []"),
    ("clamp: Clamp, ", ""),
    ("gain_uncertainty: 0.2 %", "gain_uncertainty: -0.2 %"),
    ("unit: V\n", "unit: V\n    scale_uncertainty: 2.5\n"),
    ("unit: V\n", "unit: V\n    zero_drift: 101 %\n"),
    ("grip_offset: 6 mm", "centre_uncertainty: -1 mm"),
    ("length: 85 mm", "length: 85 mm, uncertainty: {length: 85 mm}"),
    ("length: 85 mm", "section: {area: 5 mm^2}, uncertainty: {area: 0.1 cm^2}"),
    ("length: 85 mm", "uncertainty: {lenght: 1 mm}"),
    (
        "unit: V\n",
        (
            "unit: V\n    certificate: {number: LC-7 / 2026, date: 2026-01-10, "
            "due: 2027-01-10, uncertainty: 0.5 %}\n"
        ),
    ),
    (
        "reader: motive-csv\n",
        (
            "reader: motive-csv\n    scale_uncertainty: 1 %\n    certificate: "
            "{number: LC-7 / 2026, date: 2026-01-10, due: 2027-01-10, "
            "uncertainty: 0.5 %}\n"
        ),
    ),
    ("unit: V\n", "unit: V\n    certificate: {number: 7, date: 2026-01-10, due: 2025-01-10}\n"),
    ("unit: V\n", "unit: V\n    certificate: {number: 7, date: 2026-01-10, due: 2026-01-10}\n"),
    ("unit: V\n", "unit: V\n    certificate: {number: 7, date: January, due: 2025-01-10}\n"),
    ("unit: V\n", "unit: V\n    certificate: {number: 7, date: 2026-01-10, k: 0.5}\n"),
    ("unit: V\n", "unit: V\n    certificate: {date: 2026-01-10}\n"),
]


TUBE_FAULTS = [
    (TUBE[TUBE.index("curve:") : TUBE.index("branches:")], ""),
    (TUBE[TUBE.index("results:") : TUBE.index("report:")], ""),
    ("plausible_peak: {from: 20 N, to: 2 kN}", "quantity: forse, plausible_peak: {from: 3, to: 2}"),
    ("displacement: {", "displacement: {zero_drift: 1 %, "),
    (
        "{result: normalised-stiffness, of: stiffness_first}",
        "{result: normalised-stiffness, of: stifness_first}",
    ),
    (
        (
            "  - {result: stiffness, name: stiffness_first, from: 2 mm, to: 8 mm}\n  "
            "- {result: two-segments, from: 2 mm, to: 20 mm}\n"
        ),
        "",
    ),
    ("of: segment_stiffness_first", "of: break_point"),
    ("  - {result: slack}\n", "  - {result: slack}\n  - {result: slack}\n"),
    (
        "  - {result: slack}\n",
        ("  - {result: slack}\n  - {result: modulus, of: stiffness_first, area: annulus}\n"),
    ),
    (
        "  - {result: slack}\n",
        "  - {result: slack}\n  - {result: normalised-stiffness, of: stiffness_first}\n",
    ),
    (
        "  - {result: slack}\n",
        (
            "  - {result: slack}\n  - {result: stiffness, name: failure_force, "
            "from: 0 mm, to: 1 mm}\n"
        ),
    ),
    (
        "  - {result: two-segments, from: 2 mm, to: 20 mm}\n",
        (
            "  - {result: stiffness, name: break_point, from: 0 mm, to: 1 mm}\n  - "
            "{result: two-segments, from: 2 mm, to: 20 mm}\n"
        ),
    ),
    ("  failure: {force_below: 50 %}\n", ""),
    ("  slips: {decision: marked, min_drop: 2 N}\n", "  slips: null\n"),
    ("  slack: {from: 10 %, to: 30 %}\n", ""),
    ("branches: {channel: displacement, min_stroke: 5 mm}\n", ""),
    ("main: [stiffness_first,", "main: [stifness_first,"),
    ("peak_force.2]", "peak_force]"),
    ("plausible_peak: {from: 20 N, to: 2 kN}", "plausible_peak: {from: 20, to: 2 kN}"),
    ("plausible_peak: {from: 20 N, to: 2 kN}", "plausible_peak: {from: 20 N, to: 2 mm}"),
    ("plausible_peak: {from: 20 N, to: 2 kN}", "plausible_peak: {from: 2 kN, to: 20 N}"),
    ("plausible_peak: {from: 20 N, to: 2 kN}", "plausible_peak: {from: 20 N, to: 20 N}"),
    ("plausible_peak: {from: 20 N, to: 2 kN}", "plausible_peak: {from: -1 N, to: 20 N}"),
    ("plausible_peak: {from: 20 N, to: 2 kN}", "plausible_peak: {from: 20 N}"),
    ("    channels:\n", "    plausible_peak: {from: 1 N, to: 2 N}\n    channels:\n"),
    ("reader: load-frame", "reader: dspace-csv"),
    ("reader: load-frame", "reader: [dspace-csv, dspace-mat]"),
    ("dialect: [mts-testsuite, table]", "dialect: []"),
    ("[Load, Force]", "[]"),
    ("[Load, Force]", "null"),
    ("[Load, Force]", "[Load, {a: b}]"),
    ("by: line", "by: slope"),
    ("to: 20 mm", "to: 1 mm"),
    ("to: 400 N", "to: 50 N"),
    ("{from: 10 %, to: 30 %}", "{from: 30 %, to: 10 %}"),
    ("force_below: 50 %", "force_below: 150 %"),
    ("decision: marked", "decision: mark"),
    ("value: 0.2 um/N", "value: 0.2 um"),
    ("area: rectangle", "area: rectangel"),
    (", area: rectangle", ""),
    ("area: rectangle", "area: rectangle, name: E"),
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
    (
        "wires: {B1: {number: 4, diameter: 1.6 mm}, B2: {number: 3, diameter: "
        "1.6 mm}}\npositions: [[0 mm, 0 mm], [2 mm, 0 mm]]"
    ),
    ("wires: {B1: 1, B2: {number: 1, diameter: 1.6 mm}}\npositions: [[0 mm, 0 mm], [2 mm, 0 mm]]"),
    "wires: {B1: 1}\npositions: [[0 mm, 0 mm, 0 mm]]",
    "wires: {B1: 1}\npositions: [0 mm]",
    "wires: {B1: 1}\npositions: [[0 mm, 1]]",
    "wires: {B1: 7}\ntaping: coarse",
    "wires: {B1: 7}\ntape: PET",
    "wires: {B1: 7}\nconduit_bore: 10.7 mm",
    (
        "wires: {B1: {number: 4, diameter: 1.6 mm}, B2: {number: 3, diameter: "
        "1.6 mm}}\nconduit: tube\nconduit_bore: 4.4 mm"
    ),
    "wires: {B1: {number: 1, diameter: 3 mm}}\nconduit: tube\nconduit_bore: 2.9 mm",
    "tape: none",
]


SHEET_FAULTS = [
    ("force.mat", "[a.mat, ../b.mat]"),
    ("force.mat", "' '"),
    ("{force: force.mat}", "{}"),
    ("{force: ", "{forse: "),
    ("length: 80", "lenght: 80"),
    ("width:", "Width:"),
    ("spool: A2-s1", "spol: A2-s1"),
    ("width: 2 mm", "colour: red"),
    ("width: 2 mm", "weight: 3 g"),
    ("width: 2 mm", "width: 2"),
    ("width: 2 mm", "labels: {Cured: 24 h}"),
    ("width: 2 mm", "labels: {spool: s2}"),
    ("width: 2 mm", "labels: [cured]"),
    ("width: 2 mm", "labels: {cured: }"),
    ("width: 2 mm", "bundle: 7 B1"),
    ("protocol: wire\n", "protocol: wire\ndate: 4.3.2026\n"),
    ("protocol: wire\n", "protocol: wire\noverrides: {a.b: {value: 1}}\n"),
]


HARNESS_FAULTS = [
    ("length: 0.3 m", "length: 0.3"),
    ("length: 0.3 m", "length: 0.3 N"),
    ("elements: 30", "elements: 3"),
    ("    diameter: 2.2 mm\n", ""),
    ("    largest_curvature: 80 1/m\n", ""),
    ("    bending_stiffness: 150 N*mm^2", "    wire: A2\n    bending_stiffness: 150 N*mm^2"),
    ("    bending_stiffness: 150 N*mm^2\n", ""),
    ("    mass_per_length: 7 g/m", "    sheet: wires.xlsx"),
    ("at: start", "at: begin"),
    ("[3, 0, 4]", "[0, 0, 0]"),
    ("[3, 0, 4]", "[3, 0]"),
    ("[3, 0, 4]", "right"),
    ("kind: grip", "kind: gripp"),
    ("name: stud", "name: left"),
    ("at: 200 mm", "at: start"),
    ("at: end", "at: 0.2 m"),
    ("step: 20", "step: 10"),
    ("step: 20", "step: 31"),
    ("release: 25", "release: 31"),
    ("by: 5", "by: 50"),
    ("[10, 20]", "[10, 40]"),
    ("at: 200 mm\n", "at: 200 mm\n    holds: position\n"),
    ("friction: 0.3", "friction: -1"),
    ("steps: 30", "stpes: 30"),
    ("[310 mm, 320 mm]", "[310 mm]"),
]


REACH_FAULTS = [
    ("250 mm", "301 mm"),
    ("at: end", "at: 310 mm"),
    (
        "  - {kind: clip, name: right, at: end, position: [10 mm, 250 mm, 0 mm]}",
        (
            "  - {kind: grip, name: mid, at: 100 mm, path: [{step: 5, position: "
            "[0 mm, 90 mm, 0 mm]}, {step: 15, position: [0 mm, 30 mm, 99 mm]}], "
            "release: 20}\n  - {kind: clip, by: 10, name: right, at: end, "
            "position: [10 mm, 150 mm, 0 mm]}"
        ),
    ),
    ("    diameter", "    diameter: 2.2 mm\nsweep: {length: [400 mm, 240 mm, 200 mm]}\n#"),
    (
        "boundaries:\n",
        (
            "boundaries:\n  - {kind: string, name: thread, at: 100 mm, length: 50 "
            "mm, anchor: [0 mm, 0 mm, 200 mm]}\n"
        ),
    ),
    (
        "boundaries:\n",
        (
            "boundaries:\n  - {kind: ring, name: guide, position: [0 mm, 100 mm, "
            "120 mm], direction: [0, 1, 0]}\n"
        ),
    ),
    (
        "boundaries:\n",
        (
            "boundaries:\n  - {kind: plane, name: table, point: [0 mm, 0 mm, -1 "
            "mm], normal: [0, 0, 5]}\n"
        ),
    ),
    ("position: [10 mm, 250 mm, 0 mm]}", "position: [10 mm, 250 mm, 0 mm], turn: 540 deg, by: 3}"),
    (
        "  - {kind: clip, name: right, at: end, position: [10 mm, 250 mm, 0 mm]}",
        (
            "  - {kind: grip, name: right, at: end, path: [{step: 4, turn: 90 "
            "deg}, {step: 6, position: [10 mm, 250 mm, 0 mm]}, {step: 7, turn: "
            "-100 deg}]}"
        ),
    ),
    (
        "  - {kind: clip, name: right, at: end, position: [10 mm, 250 mm, 0 mm]}",
        (
            "  - {kind: pin, name: right, at: end, position: [10 mm, 250 mm, 0 "
            "mm], by: 9, release: 9}"
        ),
    ),
    (
        "  - {kind: clip, name: right, at: end, position: [10 mm, 250 mm, 0 mm]}",
        (
            "  - {kind: grip, name: right, at: end, release: 4, path: [{step: 6, "
            "position: [10 mm, 250 mm, 0 mm]}, {step: 9, position: [10 mm, 240 "
            "mm, 0 mm]}]}"
        ),
    ),
    ("  section:", "  spool: {curvature: 500 1/m}\n  section:"),
    ("bending_stiffness: 150 N*mm^2", "sliders: none.sliders.json\n#"),
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


WORD_FAULTS = [
    (Text, True),
    (Text, ""),
    (FileStem, "a/b"),
    (Line, "A\x072"),
    (Line, "\ud800"),
    (Line, "A2\n"),
    (FileStem, "nul.1"),
    (Snake, "Force"),
]


QUANTITY_FAULTS = [
    (Length, "53"),
    (Length, "53 s"),
    (Length, None),
    (Mass, "-1 g"),
    (Offset, "1e400 mm"),
    (Ratio, "5 deg"),
    (Share, "0 %"),
    (Share, "110 %"),
    (Compliance, "0.2 mm"),
    (Span, "51"),
    (Span, "0 samples"),
    (Span, "120 %"),
    (Span, "0 s"),
    (Length, "12,5 mm"),
    (Length, "2,1 mm"),
    (Length, "-0,125 mm"),
    (Length, "1,000 mm"),
    (Length, "1 000 mm"),
    (Length, "1'000 mm"),
    (Length, "1.000,5 mm"),
    (Length, "1,000.5 mm"),
    (Length, "1 000 000,25 mm"),
    (Length, "85"),
    (Length, "85 kg"),
    (Length, "85 MM"),
    (Length, "20 1/m"),
    (Length, "0 mm"),
    (Length, "-5 mm"),
    (Force, "5 kg"),
    (Force, "500 g"),
    (Mass, "5 N"),
    (Ratio, "0,5"),
    (Ratio, "0,5 %"),
    (Span, "0,1 s"),
    (Span, "0,1 mm"),
    (Span, "1 kg"),
]


PLAN_FAULTS = [
    ("_force.mat", "_{forse}.mat"),
    ("-{sample}.csv", ".csv"),
    ("{type}-{length mm}-{sample}.csv", "take.csv"),
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
    ("  - {step: three-point-shape, over: 2 s, section: 4 mm, facing: side}\n", ""),
    ("  - {step: repair-markers, max_gap: 0.5 s, max_jump: 4 mm, frozen: 0.2 s}\n", ""),
    ("channel: displacement, force: force", "channel: displacement, force: forze"),
    ("cycles: 1", "cycles: 3"),
    ("    optional: true\n    reader: load-frame", "    reader: load-frame"),
]


Change = tuple[str, str]


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
    bundles = [*BUNDLE_FAULTS, f"{SEVEN}positions: [{CLOSE}]"]
    sheets = {text: BUNDLE.format(text.strip().replace("\n", "\n    ")) for text in bundles}
    sheets |= {new: changed(PLAIN, [(old, new)]) for old, new in SHEET_FAULTS}
    approved(refused(new, _sheet, text) for new, text in sheets.items())


def _sheet(text: str) -> object:
    return checked(TestSheet, parse_yaml(text, "x"))


def test_values(approved: Approve) -> None:
    approved(
        refused(str(text), _parse, kind, text) for kind, text in [*WORD_FAULTS, *QUANTITY_FAULTS]
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
        (load_harness, WHOLE, HARNESS_FAULTS),
        (load_harness, BETWEEN_CLIPS, REACH_FAULTS),
    ],
    ids=["campaign", "harness", "reach"],
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
