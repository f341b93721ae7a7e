from __future__ import annotations

import pytest

from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import (
    AlignNone,
    AlignTurningPoints,
    Failure,
    MachineCompliance,
    Slips,
)
from labpipe.records.declarations import Smooth, Span
from tests.protocol.conftest import Told


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


CASES = {
    "version": (
        ("version: 1", "version: 2"),
        "p.yaml, line 1, column 10 (version): expected version 1, the only one that this labpipe"
        " knows, found '2'. A newer labpipe may know this version.",
    ),
    "unknown key": (
        ("results:\n", "resluts:\n"),
        "p.yaml, line 24, column 1 (resluts): expected one of the keys 'results', 'report',"
        " 'markers', 'sources', 'branches', 'about', ..., found 'resluts'. Did you mean 'results'?",
    ),
    "missing key": (
        ("name: wire\n", ""),
        "p.yaml, line 1, column 1: expected the key 'name', found no such key. Add the key 'name'.",
    ),
    "role": (
        ("  markers:\n", "  marker:\n"),
        "p.yaml, line 9, column 3 (sources.marker): expected one of 'markers', 'force', 'frame',"
        " found 'marker'. Did you mean 'markers'?",
    ),
    "reader": (
        ("[dspace-mat,", "[dspace-mta,"),
        "p.yaml, line 5, column 14 (sources.force.reader.0): expected one of 'dspace-mat',"
        " 'dspace-mf4', 'dspace-csv', 'load-frame', 'motive-csv', 'motive-xlsx', found"
        " 'dspace-mta'."
        " Did you mean 'dspace-mat'?",
    ),
    "no reader": (
        ("[dspace-mat, dspace-csv]", "[]"),
        "p.yaml, line 5, column 13 (sources.force.reader): expected at least one entry,"
        " found an empty list.",
    ),
    "step": (
        ("step: smooth", "step: smoth"),
        "p.yaml, line 21, column 12 (steps.4.step): expected one of 'smooth', 'decimate',"
        " 'fit-shape', 'zero', 'specimen-frame', 'three-point-shape', ..., found 'smoth'."
        " Did you mean 'smooth'?",
    ),
    "no step": (
        ("{step: zero,", "{"),
        "p.yaml, line 20, column 5 (steps.3): expected the key 'step', found no such key."
        " Add the key 'step'.",
    ),
    "window": (
        ("to: 4 mm", "to: 0.5 mm"),
        "p.yaml, line 27, column 51 (results.2.to): expected more than 'from' (0.5 mm),"
        " found '0.5 mm'.",
    ),
    "figure": (
        ("wire-shapes", "wire-shape"),
        "p.yaml, line 30, column 33 (report.figures.1): expected one of 'wire-shapes',"
        " 'force-displacement', 'timeline', 'stiffness-lines', 'moment-curvature',"
        " 'uncertainty-budget', ..., found 'wire-shape'."
        " Did you mean 'wire-shapes'?",
    ),
    "speed": (
        ("crosshead_speed: 1 mm/s", "crosshead_speed: 0 mm/s"),
        "p.yaml, line 12, column 24 (rig.crosshead_speed): expected a quantity with a unit such as"
        " mm/s above 0 mm/s, found '0 mm/s'.",
    ),
    "unit": (
        ("max_gap: 0.5 s", "max_gap: 0.5"),
        "p.yaml, line 17, column 37 (steps.0.max_gap): expected a quantity with a unit such as s,"
        " found '0.5'. Write it with its unit, such as '0.5 s'.",
    ),
    "cycles": (
        ("cycles: 3", "cycles: three"),
        "p.yaml, line 12, column 40 (rig.cycles): expected a whole number from 1 to 1000000,"
        " found 'three'.",
    ),
    "markers": (
        ("along: all", "along: []"),
        "p.yaml, line 13, column 32 (markers.along): expected the word 'all', or a list of marker"
        " names, found an empty list.",
    ),
    "clamp not said": (
        ("clamp: Clamp, ", ""),
        "p.yaml, line 13, column 10 (markers): expected the key 'clamp', found no such key."
        " Add the key 'clamp'.",
    ),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_what_is_wrong_is_told(case: tuple[tuple[str, str], str], told: Told) -> None:
    change, message = case

    assert any(line.startswith(message) for line in told(change))


OF_TUBE = {
    "by": (
        ("by: line", "by: slope"),
        "p.yaml, line 14, column 51 (steps.0.by): expected one of 'line', 'mean', found 'slope'."
        " Did you mean 'line'?",
    ),
    "window of two segments": (
        ("to: 20 mm", "to: 1 mm"),
        "p.yaml, line 26, column 44 (results.2.to): expected more than 'from' (2 mm), found"
        " '1 mm'.",
    ),
    "window of force": (
        ("to: 400 N", "to: 50 N"),
        "p.yaml, line 33, column 42 (results.9.to): expected more than 'from' (50 N), found"
        " '50 N'.",
    ),
    "window of slack": (
        ("{from: 10 %, to: 30 %}", "{from: 30 %, to: 10 %}"),
        "p.yaml, line 21, column 27 (curve.slack.to): expected more than 'from' (30 %), found"
        " '10 %'.",
    ),
    "share of the whole": (
        ("force_below: 50 %", "force_below: 150 %"),
        "p.yaml, line 19, column 26 (curve.failure.force_below): expected a pure number (also in %"
        " or ppm) above 0 %, at most 100 %, found '150 %'.",
    ),
    "decision": (
        ("decision: marked", "decision: mark"),
        "p.yaml, line 20, column 21 (curve.slips.decision): expected one of 'marked', 'repaired',"
        " 'cut', found 'mark'. Did you mean 'marked'?",
    ),
    "compliance": (
        ("value: 0.2 um/N", "value: 0.2 um"),
        "p.yaml, line 18, column 23 (curve.compliance.value): expected a quantity with a unit such"
        " as um/N, found '0.2 um'. um is a unit of length."
        " Write it with its unit, such as '0.2 um/N'.",
    ),
    "area": (
        ("area: rectangle", "area: rectangel"),
        "p.yaml, line 28, column 58 (results.4.area): expected one of 'rectangle', 'stated',"
        " 'annulus', 'thin-wall', found 'rectangel'. Did you mean 'rectangle'?",
    ),
    "no area": (
        (", area: rectangle", ""),
        "p.yaml, line 28, column 5 (results.4): expected the key 'area', found no such key."
        " Add the key 'area'.",
    ),
    "name of a modulus": (
        ("area: rectangle", "area: rectangle, name: E"),
        "p.yaml, line 28, column 75 (results.4.name): expected a name of small letters, digits and"
        " '_', a letter first, found 'E'.",
    ),
    "margin": (
        ("margin: 10 %", "margin: 1 mm"),
        "p.yaml, line 36, column 83 (groups.margin): expected a pure number (also in % or ppm),"
        " found '1 mm'. mm is a unit of length. Write it with its unit, such as '10 %'.",
    ),
    "yes or no": (
        ("scaled: true", "scaled: perhaps"),
        "p.yaml, line 36, column 57 (groups.scaled): expected true or false, found 'perhaps'.",
    ),
}


@pytest.mark.parametrize("case", OF_TUBE.values(), ids=OF_TUBE)
def test_what_is_wrong_with_a_tensile_test_is_told(
    case: tuple[tuple[str, str], str], told_of_tube: Told
) -> None:
    change, message = case

    assert any(line.startswith(message) for line in told_of_tube(change))


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


def test_groups_that_nobody_speaks_of(wire: str) -> None:
    groups = parse_protocol(wire, "p.yaml").groups

    assert (groups.main, groups.scaled, groups.margin) == ((), False, None)
    assert (groups.min_p, groups.max_spool_share) == (0.05, 0.1)


@pytest.mark.parametrize(
    ("said", "meant"), [("all", "all"), ("A", ("A",)), ("[A, B*]", ("A", "B*"))]
)
def test_the_markers_along_the_specimen(wire: str, said: str, meant: object) -> None:
    protocol = parse_protocol(wire.replace("along: all", f"along: {said}"), "p.yaml")

    assert protocol.markers is not None
    assert protocol.markers.along == meant
