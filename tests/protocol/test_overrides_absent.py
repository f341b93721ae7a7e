from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.load import (
    dump_protocol,
    load_protocol,
    load_test_sheet,
    parse_protocol,
    resolve,
)
from labpipe.protocol.overrides import absent_faults, without_absent
from labpipe.protocol.schema import AlignNone, Protocol

CONDUIT = Path(__file__).parents[2] / "protocols" / "conduit-bundle.yaml"
SHEET = """\
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


def test_a_measured_displacement_goes_before_the_speed(whole: Protocol) -> None:
    kept = without_absent(whole, ["force", "frame", "markers"])

    assert "travel-from-speed displacement" not in steps(kept)
    assert set(kept.sources) == {"force", "frame", "markers"}
    assert kept.results == whole.results


def test_without_a_frame_the_displacement_is_made_on_one_clock(whole: Protocol) -> None:
    kept = without_absent(whole, ["force"])

    assert steps(kept) == ["zero force", "travel-from-speed displacement", "smooth force"]
    assert kept.align == AlignNone()
    assert "clock" not in [each.result for each in kept.results]
    assert list(absent_faults(kept, whole)) == []


def test_without_cameras_shape_and_twist_are_not_asked_for(whole: Protocol) -> None:
    kept = without_absent(whole, ["force", "frame"])

    asked = {each.result for each in kept.results}
    assert not {"mid-span", "twist"} & asked
    assert "clock" in asked
    drawn = ("force-displacement", "stiffness-lines", "timeline", "uncertainty-budget")
    assert kept.report.figures == drawn
    assert "mid_span_bending_stiffness" not in kept.groups.main
    assert kept.markers is None


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
def tell(tmp_path: Path) -> Callable[..., str]:
    """Give the error of a test with some files and a changed protocol."""

    def tell(files: str, *changes: tuple[str, str]) -> str:
        text = CONDUIT.read_text(encoding="utf-8")
        for old, new in changes:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        folder = tmp_path / "protocols"
        folder.mkdir()
        (folder / "conduit-bundle.yaml").write_text(text, encoding="utf-8")
        path = tmp_path / "test.yaml"
        path.write_text(SHEET % files, encoding="utf-8")
        with pytest.raises(ProtocolError) as info:
            resolve(load_test_sheet(path), path, folder)
        return str(info.value).replace(f"{tmp_path}{os.sep}", "")

    return tell


def test_neither_frame_nor_speed(tell: Callable[..., str]) -> None:
    found = tell("force: a.mat", ("crosshead_speed: 0.5 mm/s, ", ""))

    assert found.partition(": ")[2] == (
        "expected a file in the role 'frame', or 'rig.crosshead_speed' to make 'displacement' from,"
        " found neither. Add the file to 'files', or 'rig.crosshead_speed' to the protocol."
    )


def test_neither_frame_nor_a_step_that_makes_the_displacement(tell: Callable[..., str]) -> None:
    text = CONDUIT.read_text(encoding="utf-8")
    step = next(line for line in text.splitlines() if "travel-from-speed" in line)

    found = tell("force: a.mat", (f"{step}\n", ""))

    assert found.partition(": ")[2] == (
        "expected a file in the role 'frame', which gives 'displacement', found none. Add it to "
        "'files', or add the step 'travel-from-speed' to the protocol."
    )


def test_a_source_that_is_not_optional_is_still_needed(tell: Callable[..., str]) -> None:
    found = tell("frame: a.txt")

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


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "method: common-start",
            "method: none",
            "expected a method that joins the two clocks of the curve, found none",
        ),
        (
            "  - {step: three-point-shape, over: 2 s, section: 4 mm, facing: side}\n",
            "",
            "expected the step 'three-point-shape' for 'twist', found no such step. Add the step "
            "'three-point-shape'.",
        ),
        (
            "  - {step: repair-markers, max_gap: 0.5 s, max_jump: 4 mm, frozen: 0.2 s}\n",
            "",
            "expected 'repair-markers' before 'three-point-shape', found no such step before. Put "
            "the step 'repair-markers' before it.",
        ),
        (
            "channel: displacement, force: force",
            "channel: displacement, force: forze",
            "found 'forze'. Did you mean 'force'?",
        ),
        (
            "cycles: 1",
            "cycles: 3",
            "expected one cycle for 'travel-from-speed', found 3. Remove the step, or set "
            "'rig.cycles' to 1.",
        ),
        (
            "    optional: true\n    reader: load-frame",
            "    reader: load-frame",
            "expected a name that a step has not taken, found 'displacement'. Rename it.",
        ),
    ],
)
def test_parts_that_do_not_fit(old: str, new: str, told: str) -> None:
    text = CONDUIT.read_text(encoding="utf-8")
    assert text.count(old) == 1
    with pytest.raises(ProtocolError) as info:
        parse_protocol(text.replace(old, new), "p.yaml")
    assert told in str(info.value)
