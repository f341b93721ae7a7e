from __future__ import annotations

import pytest

from labpipe.protocol.load import parse_protocol
from tests.protocol.conftest import Told

MARKERS = "  markers:\n    reader: motive-csv\n"
CASES = {
    "channel of a step": (
        "zero, channel: force",
        "zero, channel: forse",
        "p.yaml, line 20, column 27 (steps.3.channel): expected one of the channels 'force',"
        " 'travel', 'deflection', found 'forse'. Did you mean 'force'?",
    ),
    "channel not made yet": (
        "steps:\n",
        "steps:\n  - {step: zero, channel: travel, over: 1 s}\n",
        "p.yaml, line 17, column 27 (steps.0.channel): expected a channel that exists at this step,"
        " found 'travel'. Move it behind the step that makes this channel.",
    ),
    "channel of align": (
        "turning-points, channel: force",
        "turning-points, channel: forc",
        "p.yaml, line 14, column 42 (align.channel): expected one of the channels 'force',"
        " found 'forc'. Did you mean 'force'?",
    ),
    "channel of the curve": (
        "displacement: deflection",
        "displacement: deflexion",
        "p.yaml, line 22, column 37 (curve.displacement): expected one of the channels"
        " 'deflection', 'travel', 'force', found 'deflexion'. Did you mean 'deflection'?",
    ),
    "channel of the branches": (
        "branches: {channel: travel",
        "branches: {channel: trawel",
        "p.yaml, line 23, column 21 (branches.channel): expected one of the channels 'travel',"
        " 'force', 'deflection', found 'trawel'. Did you mean 'travel'?",
    ),
    "unit of the curve": (
        "curve: {force: force",
        "curve: {force: travel",
        "p.yaml, line 22, column 16 (curve.force): expected a channel in N, found 'travel' in m."
        " Name another channel.",
    ),
    "sign of what a step makes": (
        "displacement: deflection",
        "displacement: deflection, reverse: [displacement]",
        "p.yaml, line 22, column 58 (curve.reverse): expected a channel that a source gives, found"
        " 'deflection', which a step makes. Its sign is that of the specimen frame: take it out of"
        " 'curve.reverse'.",
    ),
    "curve over two clocks": (
        "{method: turning-points, channel: force, motion_window: 25 s, force_window: 2 s,\n"
        "  max_residual: 5 ms, max_drift: 500 ppm}",
        "{method: none}",
        "p.yaml, line 14, column 17 (align.method): expected a method that joins the two clocks of"
        " the curve, found none. Set 'align.method' to 'turning-points'.",
    ),
    "clamp": (
        "clamp: Clamp",
        "clamp: null",
        "p.yaml, line 14, column 17 (align.method): expected a clamp whose motion has the turning"
        " points, found none. Name the rigid body at the clamp in 'markers.clamp'.",
    ),
    "markers block": (
        "markers: {clamp: Clamp, along: all, grip_offset: 6 mm}\n",
        "",
        "p.yaml, line 16, column 12 (steps.0.step): expected a block 'markers' for"
        " 'repair-markers', found none. Add the block 'markers'.",
    ),
    "marker source": (
        MARKERS,
        "",
        "p.yaml, line 15, column 12 (steps.0.step): expected a source of marker tracks for"
        " 'repair-markers', found none. Add the source 'markers'.",
    ),
    "align without marker source": (
        MARKERS,
        "",
        "p.yaml, line 12, column 17 (align.method): expected a source of marker tracks for"
        " 'turning-points', found none. Add the source 'markers'.",
    ),
    "second of a step": (
        "  - {step: specimen-frame, over: 2 s}\n",
        "  - {step: specimen-frame, over: 2 s}\n" * 2,
        "p.yaml, line 19, column 12 (steps.2.step): expected 'specimen-frame' once, found a second"
        " one. Remove one of them.",
    ),
    "order of steps": (
        "  - {step: specimen-frame, over: 2 s}\n",
        "",
        "p.yaml, line 18, column 12 (steps.1.step): expected 'specimen-frame' before 'fit-shape',"
        " found no such step before. Put the step 'specimen-frame' before it.",
    ),
    "span of a branch": (
        "branches: {channel: travel, min_stroke: 5 mm}\n",
        "",
        "p.yaml, line 25, column 14 (results.1.result): expected a block 'branches' for"
        " 'peak-force', found none. Add the block 'branches'.",
    ),
    "branches without curve": (
        "curve: {force: force, displacement: deflection}\n",
        "",
        "p.yaml, line 22, column 11 (branches): expected a block 'curve' for 'branches',"
        " found none. Add the block 'curve'.",
    ),
    "figure without curve": (
        "curve: {force: force, displacement: deflection}\n",
        "",
        "p.yaml, line 29, column 13 (report.figures.0): expected a block 'curve' for"
        " 'force-displacement', found none. Add the block 'curve'.",
    ),
    "figure without shape": (
        "  - {step: fit-shape, terms: 7, tip: free}\n",
        "",
        "p.yaml, line 29, column 33 (report.figures.1): expected the step 'fit-shape' for"
        " 'wire-shapes', found no such step. Add the step 'fit-shape'.",
    ),
    "figure without markers": (
        "figures: [force-displacement, wire-shapes]",
        "figures: [force-displacement, wire-shapes, wire-shapes]",
        "p.yaml, line 30, column 46 (report.figures.2): expected each figure once, found"
        " 'wire-shapes' again. Remove one of them.",
    ),
    "second of a result": (
        "  - {result: clock}\n",
        "  - {result: clock}\n  - {result: clock}\n",
        "p.yaml, line 26, column 14 (results.1.result): expected each result once, found a second"
        " 'clock'. Remove one of them.",
    ),
    "second window": (
        "  - {result: clock}\n",
        "  - {result: stiffness, from: 0 mm, to: 1 mm}\n" * 2,
        "p.yaml, line 26, column 14 (results.1.result): expected each result once, found a second"
        " 'stiffness'. Give it another 'name'.",
    ),
    "displayed quantity": (
        "{displacement: mm,",
        "{displacment: mm,",
        "p.yaml, line 29, column 13 (report.display.displacment): expected one of the quantities"
        " 'displacement', 'compliance', 'length', 'moment', 'time', 'speed', ..., found"
        " 'displacment'."
        " Did you mean 'displacement'?",
    ),
    "display unit": (
        "{displacement: mm,",
        "{displacement: mN,",
        "p.yaml, line 29, column 27 (report.display.displacement): expected a unit of displacement"
        " such as m, found 'mN'. Write the unit alone, without a number.",
    ),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_what_does_not_fit_together_is_told(case: tuple[str, str, str], told: Told) -> None:
    old, new, message = case

    assert message in told((old, new))


def test_a_share_of_a_branch_needs_branches(told: Told) -> None:
    lines = told(
        ("span: 0.1 s", "span: 5 %"), ("branches: {channel: travel, min_stroke: 5 mm}", "")
    )

    assert (
        "p.yaml, line 21, column 66 (steps.4.span): expected a span of time or samples where there"
        " are no branches, found '5 %'. Add the block 'branches', or give the span in s."
    ) in lines


def test_results_of_what_is_not_there(told: Told) -> None:
    lines = told(
        ("result: peak-force", "result: tip-travel"),
        ("  - {step: fit-shape, terms: 7, tip: free}\n", ""),
        ("method: turning-points", "method: none"),
        ("wire-shapes", "marker-quality"),
        ("  markers:\n    reader: motive-csv\n", ""),
    )

    assert (
        "p.yaml, line 23, column 14 (results.1.result): expected the step 'fit-shape' for"
        " 'tip-travel', found no such step. Add the step 'fit-shape'."
    ) in lines
    assert (
        "p.yaml, line 22, column 14 (results.0.result): expected 'align.method' to be"
        " 'turning-points' for 'clock', found another. Set 'align.method' to 'turning-points'."
    ) in lines
    assert (
        "p.yaml, line 27, column 33 (report.figures.1): expected a source of marker tracks for"
        " 'marker-quality', found none. Add the source 'markers'."
    ) in lines


LAW = "  - {result: moment-curvature, at: 5 1/m}\n"


def test_moment_curvature_stands_where_there_is_a_clamp(told: Told) -> None:
    lines = told(("results:\n", f"results:\n{LAW}"), ("clamp: Clamp", "clamp: null"))

    assert (
        "p.yaml, line 25, column 14 (results.0.result): expected a clamped end for"
        " 'moment-curvature', found none. Name the rigid body at the clamp in 'markers.clamp'."
    ) in lines


def test_moment_curvature_needs_shapes_and_the_clock_of_the_markers(told: Told) -> None:
    step = "  - {step: fit-shape, terms: 7, tip: free}\n"
    lines = told(
        ("results:\n", f"results:\n{LAW}"),
        (step, ""),
        ("displacement: deflection", "displacement: force"),
    )

    assert (
        "p.yaml, line 24, column 14 (results.0.result): expected the step 'fit-shape' for"
        " 'moment-curvature', found no such step. Add the step 'fit-shape'."
    ) in lines
    assert (
        "p.yaml, line 24, column 14 (results.0.result): expected a curve on the clock of the"
        " markers for 'moment-curvature', found displacement 'force'. Set 'curve.displacement' to"
        " 'deflection'."
    ) in lines


def test_moment_curvature_is_drawn_where_it_is_asked_for(told: Told) -> None:
    lines = told(("wire-shapes", "moment-curvature"))

    assert (
        "p.yaml, line 30, column 33 (report.figures.1): expected a result 'moment-curvature' for"
        " 'moment-curvature', found none. Add a result 'moment-curvature'."
    ) in lines


def test_two_clocks_without_a_block_align() -> None:
    text = """\
version: 1
name: p
sources:
  force: {reader: dspace-mat, channel: a, unit: N}
  frame: {reader: dspace-mat, channels: {displacement: {channel: b, unit: mm}}}
curve: {force: force, displacement: displacement}
"""

    with pytest.raises(
        Exception, match=r"line 6, column 8 \(curve\): expected a method that joins"
    ):
        parse_protocol(text, "p.yaml")


def test_no_channel_at_all() -> None:
    text = """\
version: 1
name: p
sources: {markers: {reader: motive-csv}}
curve: {force: f, displacement: d}
"""

    with pytest.raises(
        Exception, match=r"expected a channel, found 'f'. No source gives a channel."
    ):
        parse_protocol(text, "p.yaml")


STIFFNESS = "  - {result: stiffness, name: stiffness_first, from: 2 mm, to: 8 mm}\n"
SEGMENTS = "  - {result: two-segments, from: 2 mm, to: 20 mm}\n"
SLACK = "  - {result: slack}\n"
OF_TUBE = {
    "of a stiffness that nobody asks for": (
        "{result: normalised-stiffness, of: stiffness_first}",
        "{result: normalised-stiffness, of: stifness_first}",
        "p.yaml, line 27, column 40 (results.3.of): expected one of the stiffnesses above,"
        " 'stiffness_first', 'segment_stiffness_first', 'segment_stiffness_second', found"
        " 'stifness_first'. Did you mean 'stiffness_first'?",
    ),
    "of a stiffness where there is none": (
        STIFFNESS + SEGMENTS,
        "",
        "p.yaml, line 25, column 40 (results.1.of): expected a stiffness above it in the list,"
        " found 'stiffness_first'. Add a result 'stiffness' before it.",
    ),
    "of what is no stiffness": (
        "of: segment_stiffness_first",
        "of: break_point",
        "p.yaml, line 28, column 27 (results.4.of): expected one of the stiffnesses above,"
        " 'segment_stiffness_first', 'segment_stiffness_second', 'stiffness_first', found"
        " 'break_point'. Did you mean 'segment_stiffness_first'?",
    ),
    "second of a result": (
        SLACK,
        SLACK * 2,
        "p.yaml, line 33, column 14 (results.9.result): expected each result once, found a second"
        " 'slack'. Remove one of them.",
    ),
    "second of a modulus": (
        SLACK,
        SLACK + "  - {result: modulus, of: stiffness_first, area: annulus}\n",
        "p.yaml, line 33, column 14 (results.9.result): expected each result once, found a second"
        " 'modulus'. Give it another 'name'.",
    ),
    "second of a normalised stiffness": (
        SLACK,
        SLACK + "  - {result: normalised-stiffness, of: stiffness_first}\n",
        "p.yaml, line 33, column 14 (results.9.result): expected each result once, found a second"
        " 'stiffness_first_per_peak_force'. Remove one of them.",
    ),
    "a name that another result makes": (
        SLACK,
        SLACK + "  - {result: stiffness, name: failure_force, from: 0 mm, to: 1 mm}\n",
        "p.yaml, line 33, column 14 (results.9.result): expected each result once, found a second"
        " 'failure_force'. Give it another 'name'.",
    ),
    "a name that a later result makes": (
        SEGMENTS,
        "  - {result: stiffness, name: break_point, from: 0 mm, to: 1 mm}\n" + SEGMENTS,
        "p.yaml, line 27, column 14 (results.3.result): expected each result once, found a second"
        " 'break_point'. Give the stiffness of that name another 'name'.",
    ),
    "failure": (
        "  failure: {force_below: 50 %}\n",
        "",
        "p.yaml, line 28, column 14 (results.5.result): expected a block 'curve.failure' for"
        " 'failure', found none. Add the block 'failure' to 'curve', or take the"
        " result out: 'results.failure: {value: null, because: ...}' under"
        " 'overrides' in test.yaml.",
    ),
    "energy to break": (
        "  failure: {force_below: 50 %}\n",
        "",
        "p.yaml, line 29, column 14 (results.6.result): expected a block 'curve.failure' for"
        " 'energy-to-break', found none. Add the block 'failure' to 'curve', or take the"
        " result out: 'results.energy-to-break: {value: null, because: ...}' under"
        " 'overrides' in test.yaml.",
    ),
    "slips": (
        "  slips: {decision: marked, min_drop: 2 N}\n",
        "  slips: null\n",
        "p.yaml, line 31, column 14 (results.7.result): expected a block 'curve.slips' for 'slips',"
        " found none. Add the block 'slips' to 'curve', or take the"
        " result out: 'results.slips: {value: null, because: ...}' under"
        " 'overrides' in test.yaml.",
    ),
    "slack": (
        "  slack: {from: 10 %, to: 30 %}\n",
        "",
        "p.yaml, line 31, column 14 (results.8.result): expected a block 'curve.slack' for 'slack',"
        " found none. Add the block 'slack' to 'curve', or take the"
        " result out: 'results.slack: {value: null, because: ...}' under"
        " 'overrides' in test.yaml.",
    ),
    "two segments without branches": (
        "branches: {channel: displacement, min_stroke: 5 mm}\n",
        "",
        "p.yaml, line 25, column 14 (results.2.result): expected a block 'branches' for"
        " 'two-segments', found none. Add the block 'branches'.",
    ),
    "compliance without branches": (
        "branches: {channel: displacement, min_stroke: 5 mm}\n",
        "",
        "p.yaml, line 32, column 14 (results.9.result): expected a block 'branches' for"
        " 'compliance', found none. Add the block 'branches'.",
    ),
    "number of the report": (
        "main: [stiffness_first,",
        "main: [stifness_first,",
        "p.yaml, line 36, column 17 (groups.main.0): expected one of the results 'stiffness_first',"
        " 'segment_stiffness_first', 'stiffness_first_per_peak_force', 'segment_stiffness_second',"
        " 'failure_force', 'slip_drop.1', ..., found 'stifness_first'."
        " Did you mean 'stiffness_first'?",
    ),
    "number of the report without its cycle": (
        "peak_force.2]",
        "peak_force]",
        "p.yaml, line 36, column 34 (groups.main.1): expected one of the results 'peak_force.1',"
        " 'failure_force', 'stiffness_first_per_peak_force', 'break_point', 'compliance',"
        " 'stiffness_first', ..., found 'peak_force'. Did you mean 'peak_force.1'?",
    ),
}


@pytest.mark.parametrize("case", OF_TUBE.values(), ids=OF_TUBE)
def test_what_does_not_fit_together_in_a_tensile_test_is_told(
    case: tuple[str, str, str], told_of_tube: Told
) -> None:
    old, new, message = case

    assert message in told_of_tube((old, new))


def test_a_modulus_of_the_initial_stiffness(wire: str) -> None:
    modulus = "  - {result: modulus, of: initial_stiffness, area: stated}\n"

    protocol = parse_protocol(wire.replace("report:\n", modulus + "report:\n"), "p.yaml")

    assert protocol.results[-1].result == "modulus"


def test_lines_without_a_curve(told_of_tube: Told, tube: str) -> None:
    curve = tube[tube.index("curve:") : tube.index("branches:")]

    lines = told_of_tube((curve, ""))

    assert (
        "p.yaml, line 28, column 13 (report.figures.0): expected a block 'curve' for"
        " 'stiffness-lines', found none. Add the block 'curve'."
    ) in lines
    assert not any("curve.failure" in line for line in lines)  # said once, by 'curve' itself


def test_numbers_of_a_report_where_nobody_asks_for_any(told_of_tube: Told, tube: str) -> None:
    results = tube[tube.index("results:") : tube.index("report:")]

    assert told_of_tube((results, "")) == [
        "p.yaml, line 25, column 17 (groups.main.0): expected a result, found 'stiffness_first'."
        " The protocol asks for none.",
        "p.yaml, line 25, column 34 (groups.main.1): expected a result, found 'peak_force.2'."
        " The protocol asks for none.",
    ]


def test_windows_of_different_names_live_together(wire: str) -> None:
    windows = (
        "  - {result: stiffness, name: stiffness_first, from: 0 mm, to: 1 mm}\n"
        "  - {result: stiffness, name: stiffness_second, from: 2 mm, to: 3 mm}\n"
    )

    protocol = parse_protocol(wire.replace("  - {result: clock}\n", windows), "p.yaml")

    assert [entry.result for entry in protocol.results[:2]] == ["stiffness", "stiffness"]


def test_a_result_of_no_stiffness_lacks_its_key_alone(told: Told) -> None:
    lines = told(("- {result: clock}", "- {result: normalised-stiffness}"))

    assert len(lines) == 1
    assert "the key 'of', found no such key" in lines[0]
