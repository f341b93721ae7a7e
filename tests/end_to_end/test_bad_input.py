"""Every kind of bad input that a bench can make: told in one message, and nothing is touched."""

from __future__ import annotations

import csv
import io
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest

from tests.builders import bad_input
from tests.builders.controldesk import Axis, Signal, write_mat_v5
from tests.builders.reasons import why
from tests.builders.small_tests import Lab, Run, make_lab, small_scenario

LOAD_CELL = "Model Root/Load Cell"
Rows = list[list[str]]
Change = Callable[[Lab], object]
Refused: TypeAlias = bad_input.Refused[Lab]
Told: TypeAlias = bad_input.Told[Lab]


@pytest.fixture
def lab(processed: Lab, tmp_path: Path) -> Lab:
    """A test with earlier results."""
    return processed.copy(tmp_path)


@pytest.fixture
def refused(lab: Lab, run: Run) -> Refused:
    return bad_input.Refused(lab, run)


@pytest.fixture
def told(lab: Lab, run: Run) -> Told:
    return bad_input.Told(lab, run)


def change_take(lab: Lab, change: Callable[[Rows], Rows]) -> None:
    path = lab.raw / "take.csv"
    rows = list(csv.reader(io.StringIO(path.read_text("utf-8"))))
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\r\n").writerows(change(rows))
    path.write_text(stream.getvalue(), encoding="utf-8", newline="")


def names_of(rows: Rows) -> list[str]:
    return next(row for row in rows if len(row) > 1 and row[1] == "Name")


def without(*prefixes: str) -> Callable[[Rows], Rows]:
    """Leave out the columns of some names."""

    def change(rows: Rows) -> Rows:
        names = names_of(rows)
        kept = [not name.startswith(prefixes) for name in names]
        return [
            row if len(row) != len(names) else [c for c, k in zip(row, kept, strict=True) if k]
            for row in rows
        ]

    return change


def blank(*names: str) -> Callable[[Rows], Rows]:
    """Empty the columns of some names in every frame."""

    def change(rows: Rows) -> Rows:
        known = names_of(rows)
        return [
            ["" if name in names else cell for cell, name in zip(row, known, strict=True)]
            if row and row[0].isdecimal()
            else row
            for row in rows
        ]

    return change


def force(lab: Lab) -> tuple[np.ndarray, np.ndarray]:
    from scipy.io import loadmat

    found = loadmat(lab.raw / "force.mat", simplify_cells=True)["force"]
    y = found["Y"]
    signals = [y] if isinstance(y, dict) else y
    volts = next(each["Data"] for each in signals if each["Path"] == LOAD_CELL)
    return np.array(found["X"]["Data"]), np.array(volts)


def write_force(lab: Lab, clock: np.ndarray, volts: np.ndarray, name: str = "Out1") -> None:
    write_mat_v5(lab.raw / "force.mat", [Axis(clock)], [Signal(LOAD_CELL, name, volts)])


def change_force(lab: Lab, change: Callable[[np.ndarray, np.ndarray], None]) -> None:
    clock, volts = force(lab)
    change(clock, volts)
    write_force(lab, clock, volts)


def cut(name: str, share: float) -> Change:
    def change(lab: Lab) -> None:
        content = (lab.raw / name).read_bytes()
        (lab.raw / name).write_bytes(content[: int(share * len(content))])

    return change


# Exports that cannot be read


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.6, 0.999])
def test_truncated_mat(refused: Refused, share: float) -> None:
    message = refused(cut("force.mat", share))
    assert "force.mat" in message


@pytest.mark.parametrize("share", [0.0, 0.0005, 0.002])
def test_take_cut_in_its_header(refused: Refused, share: float) -> None:
    assert "take.csv" in refused(cut("take.csv", share))


def test_take_without_the_rigid_body(refused: Refused) -> None:
    message = refused(lambda lab: change_take(lab, without("Clamp")))
    assert "markers, rigid bodies: expected the clamp 'Clamp', found no rigid body" in message
    assert "markers.clamp" in message


def test_body_without_a_pose(refused: Refused) -> None:
    message = refused(lambda lab: change_take(lab, blank("Clamp")))
    assert "rigid body 'Clamp': expected positions, found blanks in every frame" in message


def test_fewer_than_three_markers(refused: Refused) -> None:
    gone = [f"Wire:Marker{number}" for number in range(3, 9)]
    message = refused(lambda lab: change_take(lab, without(*gone)))
    assert "expected at least 3 markers along the specimen, found 2: Wire:Marker1" in message


def test_all_samples_blank(refused: Refused) -> None:
    def nothing(clock: np.ndarray, volts: np.ndarray) -> None:
        volts[:] = np.nan

    message = refused(lambda lab: change_force(lab, nothing))
    assert f"channel '{LOAD_CELL}/Out1': expected numbers, found none" in message


def test_force_time_runs_backwards(refused: Refused) -> None:
    def swap(clock: np.ndarray, volts: np.ndarray) -> None:
        clock[[700, 701]] = clock[[701, 700]]

    message = refused(lambda lab: change_force(lab, swap))
    assert "force.mat" in message
    assert "expected time that increases from sample to sample" in message


def test_frames_run_backwards(refused: Refused) -> None:
    def swap(rows: Rows) -> Rows:
        rows[300], rows[301] = rows[301], rows[300]
        return rows

    message = refused(lambda lab: change_take(lab, swap))
    assert "take.csv" in message


def test_wrong_channel_name_says_the_nearest(refused: Refused) -> None:
    message = refused(
        lambda lab: lab.override(
            "sources.force.channel", f"{LOAD_CELL.replace('Load', 'Laod')}/Out1"
        )
    )
    assert "Model Root/Laod Cell/Out1" in message
    assert "'Model Root/Load Cell/Out1'" in message


@pytest.mark.parametrize("gain", ["0.5 N", "0.5 mm/V", "0.5"])
def test_unit_of_the_wrong_dimension(refused: Refused, gain: str) -> None:
    message = refused(lambda lab: lab.override("sources.force.calibration.gain", gain))
    assert "test.yaml, line " in message
    assert f"found '{gain}'" in message or f"found {gain}" in message or gain in message


def test_channel_of_the_wrong_dimension(refused: Refused) -> None:
    message = refused(lambda lab: lab.override("sources.force.unit", "mm"))
    assert "(sources.force.calibration.gain): expected " in message
    assert "test.yaml changes.)" in message


@pytest.mark.parametrize("name", ["../../other/force.mat", "/etc/hostname", "C:\\lab\\force.mat"])
def test_path_that_leaves_the_folder(refused: Refused, name: str) -> None:
    message = refused(lambda lab: lab.edit("test.yaml", "force: force.mat", f"force: '{name}'"))
    assert "expected a file inside the folder of the test" in message
    assert "Copy the export into the folder" in message


def test_link_that_leaves_the_folder(
    refused: Refused, tmp_path_factory: pytest.TempPathFactory
) -> None:
    outside = tmp_path_factory.mktemp("outside") / "force.mat"

    def link(lab: Lab) -> None:
        shutil.move(lab.raw / "force.mat", outside)
        (lab.raw / "force.mat").symlink_to(outside)

    message = refused(link)
    assert "a link out of it" in message
    assert "--follow-links" in message


@pytest.mark.parametrize("command", ["check", "process"])
def test_links_into_a_store_are_followed_on_demand(
    lab: Lab, run: Run, tmp_path_factory: pytest.TempPathFactory, command: str
) -> None:
    outside = tmp_path_factory.mktemp("store") / "0001.mat"
    shutil.move(lab.raw / "force.mat", outside)
    (lab.raw / "force.mat").symlink_to(outside)
    options = ["--no-figures"] if command == "process" else []
    assert run(command, lab.raw, *options).status == 2
    assert run(command, lab.raw, *options, "--follow-links").status == 0


def test_file_that_is_not_there(refused: Refused) -> None:
    message = refused(lambda lab: (lab.raw / "force.mat").unlink())
    assert "force.mat" in message


def test_files_in_each_others_role(refused: Refused) -> None:
    message = refused(
        lambda lab: lab.edit(
            "test.yaml",
            "{force: force.mat, markers: take.csv}",
            "{force: take.csv, markers: force.mat}",
        )
    )
    assert "take.csv: expected a file of the format dspace-mat" in message
    assert "found one of the format motive-csv" in message


def test_role_that_has_no_file(refused: Refused) -> None:
    message = refused(lambda lab: lab.edit("test.yaml", ", markers: take.csv}", "}"))
    assert "expected a file in the role 'markers', found none" in message


def test_role_that_the_protocol_does_not_know(refused: Refused) -> None:
    message = refused(
        lambda lab: lab.edit("test.yaml", "markers: take.csv", "frame: take.csv"), faults=2
    )
    assert "'frame'" in message
    assert "'markers'" in message


def test_three_parts_that_are_one_file_thrice(refused: Refused) -> None:
    message = refused(
        lambda lab: lab.edit(
            "test.yaml", "force: force.mat", "force: [force.mat, force.mat, force.mat]"
        )
    )
    assert "force.mat, time: expected a start after" in message


def test_takes_have_no_parts(refused: Refused) -> None:
    message = refused(
        lambda lab: lab.edit("test.yaml", "markers: take.csv", "markers: [take.csv, take.csv]")
    )
    assert "take.csv: expected a part of a recording: channels on one clock" in message


def test_sheet_that_is_no_yaml(refused: Refused) -> None:
    assert "test.yaml" in refused(lambda lab: lab.edit("test.yaml", "files: {", "files: [{"))


def test_protocol_that_does_not_exist(refused: Refused) -> None:
    message = refused(lambda lab: lab.edit("test.yaml", "wire-cantilever", "wire-cantilver"))
    assert "wire-cantilever" in message


# Recordings that can be read, but do not hold what was asked for


@pytest.mark.parametrize("cells", [0, 1])
def test_take_cut_in_mid_line(told: Told, cells: int) -> None:
    """Within the first number of a line, and within its last, which still reads as a number."""

    def cut_off(lab: Lab) -> None:
        path = lab.raw / "take.csv"
        content = path.read_bytes()
        line = content.rindex(b"\n", 0, int(0.66 * len(content)))
        end = content.index(b"\r\n", line + 1) - 2 if cells else line + 3
        path.write_bytes(content[:end])

    lab = told(cut_off)
    notes = {note["code"]: note["message"] for note in lab.summary["quality"]}
    assert "is incomplete and was left out" in notes["truncated"]
    assert notes["rows_differ"].startswith("the header states 851 rows, the file holds ")
    assert lab.results["peak_force.1"]["status"] == "ok"
    for name in ("peak_force.2", "peak_displacement.2"):
        assert lab.results[name]["status"] == "doubtful"
        assert "partial_cycle: the record ends at " in why(lab.results[name])
        assert why(lab.results[name]).endswith("while still loading")
    for name in ("unloading_stiffness.2", "energy.2", "residual_displacement.2"):
        assert why(lab.results[name]).startswith("partial_cycle: ")
        assert lab.results[name]["status"] == "failed"


def test_take_cut_while_unloading(told: Told) -> None:
    lab = told(lambda lab: change_take(lab, lambda rows: rows[:660]))
    assert lab.results["energy.2"]["status"] == "doubtful"
    assert why(lab.results["energy.2"]).endswith("while still unloading")
    assert lab.results["peak_force.2"]["status"] == "ok"


def freeze_clamp(start: float, stop: float) -> Callable[[Rows], Rows]:
    """Hold the pose of the clamp for some seconds, as a body that is lost and kept."""

    def change(rows: Rows) -> Rows:
        columns = [i for i, name in enumerate(names_of(rows)) if name == "Clamp"]
        frames = [row for row in rows if row and row[0].isdecimal()]
        held = [row for row in frames if start <= float(row[1]) <= stop]
        for row in held[1:]:
            for column in columns:
                row[column] = held[0][column]
        return rows

    return change


def test_a_pose_frozen_late_leaves_earlier_results_alone(told: Told) -> None:
    lab = told(lambda lab: change_take(lab, freeze_clamp(9.6, 10.5)))
    assert "clamp_frozen" in lab.notes
    doubtful = {name for name, each in lab.results.items() if each["status"] != "ok"}
    assert doubtful == {"energy.2"}  # in the second loading, far from its peak


def test_take_with_a_marker_missing_throughout(told: Told) -> None:
    lab = told(lambda lab: change_take(lab, blank("Wire:Marker3")))
    assert "marker_missing" in {note["code"] for note in lab.summary["quality"]}
    peak = lab.results["peak_displacement.1"]
    assert peak["status"] == "doubtful"
    assert why(peak).startswith("marker_missing: ")
    assert peak["value"] == pytest.approx(lab.truth["cycles"][0]["peak_deflection"], abs=1e-3)
    assert lab.results["peak_force.1"]["status"] == "ok"


def test_constant_force(told: Told) -> None:
    def constant(clock: np.ndarray, volts: np.ndarray) -> None:
        volts[:] = 0.25

    lab = told(lambda lab: change_force(lab, constant))
    for name in ("clock_offset", "clock_drift", "peak_force.1", "energy.1"):
        assert lab.results[name]["value"] is None
        assert lab.results[name]["status"] == "failed"
        assert why(lab.results[name]).startswith("constant_channel: the force is constant at")


def test_force_and_motion_that_do_not_overlap(told: Told) -> None:
    def only_rest(lab: Lab) -> None:
        clock, volts = force(lab)
        write_force(lab, clock[:400], volts[:400])

    lab = told(only_rest)
    assert why(lab.results["clock_offset"]).startswith("no_common_peak: ")
    assert lab.results["energy.1"]["status"] == "failed"


def test_some_samples_missing(told: Told) -> None:
    def holes(clock: np.ndarray, volts: np.ndarray) -> None:
        volts[1500:1510] = np.nan
        volts[2000] = np.inf

    lab = told(lambda lab: change_force(lab, holes))
    reasons = {n: why(each) for n, each in lab.results.items() if each["status"] != "ok"}
    assert all(why.startswith("missing_samples: 11 of ") for why in reasons.values()), reasons
    assert set(reasons) == {  # soon after the first turn, and in the second loading
        *("peak_force.1", "peak_force.2", "unloading_stiffness.1", "energy.1", "energy.2"),
        "residual_displacement.1",
    }
    assert "Infinity" not in (lab.processed / "summary.json").read_text("utf-8")


def test_marker_at_infinity(lab: Lab, run: Run) -> None:
    def far(rows: Rows) -> Rows:
        column = names_of(rows).index("Wire:Marker2")
        for row in rows[300:320]:
            row[column] = "inf"
        return rows

    change_take(lab, far)
    ran = run("process", lab.raw, "--no-figures")
    assert ran.status in (0, 1, 2)
    assert "Traceback" not in ran.err
    if ran.status == 0:
        truth = lab.truth["cycles"][0]["peak_deflection"]
        assert lab.results["peak_displacement.1"]["value"] == pytest.approx(truth, abs=2e-4)
        assert lab.summary["quality"]
    else:
        assert "take.csv" in ran.err


def test_one_cycle(tmp_path: Path, run: Run) -> None:
    lab = make_lab(tmp_path, small_scenario(cycles=1))
    assert run("process", lab.raw, "--no-figures").status == 1
    assert why(lab.results["clock_drift"]).startswith("one_event: ")
    assert lab.results["clock_offset"]["status"] == "doubtful"
    assert why(lab.results["clock_offset"]).startswith("alignment_one_event: ")
    assert lab.results["peak_force.1"]["status"] == "ok"
    assert "peak_force.2" not in lab.results
    truth = lab.truth["cycles"][0]
    assert lab.results["peak_force.1"]["value"] == pytest.approx(truth["peak_force"], abs=3e-3)


def only_rest(rows: Rows) -> Rows:
    return rows[:100]


def test_nothing_moves(told: Told) -> None:
    lab = told(lambda lab: change_take(lab, only_rest))
    for name in ("clock_offset", "peak_force.1", "energy.1", "initial_stiffness"):
        assert lab.results[name]["status"] == "failed"
        assert why(lab.results[name]).startswith("no_motion: the motion spans")


def test_nothing_moves_at_all(refused: Refused) -> None:
    """A clamp that stands still to the last digit."""

    def still(rows: Rows) -> Rows:
        return rows[:7] + [[*row[:2], *rows[7][2:]] for row in rows[7:]]

    message = refused(lambda lab: change_take(lab, still))
    assert "steps.1 (specimen-frame): " in message
    assert "expected a clamp that moves, found one that stands still. Look at the" in message


@pytest.mark.slow
def test_two_parts_of_one_recording(lab: Lab, run: Run) -> None:
    assert run("process", lab.raw, "--no-figures").status == 0
    whole = lab.results
    clock, volts = force(lab)
    for number, part in enumerate((slice(0, 1500), slice(1500, None))):
        signal = Signal(LOAD_CELL, "Out1", volts[part])
        write_mat_v5(lab.raw / f"part{number}.mat", [Axis(clock[part])], [signal])
    lab.edit("test.yaml", "force: force.mat", "force: [part0.mat, part1.mat]")
    assert run("process", lab.raw, "--no-figures").status == 0
    assert lab.results == whole


@pytest.mark.slow
def test_a_bad_test_does_not_stop_the_others(lab: Lab, run: Run) -> None:
    shutil.copytree(lab.raw, lab.raw.parent / "T0")
    (lab.raw.parent / "T0" / "force.mat").write_bytes(b"")
    ran = run("process", lab.raw.parent, "--no-figures")
    assert ran.status == 2
    assert "T0" in ran.err
    assert "T1  (wire-cantilever): 15 ok" in ran.out
