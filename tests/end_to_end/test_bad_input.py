"""Bad input that a bench can make: refused in one message or told as doubtful; nothing is touched.

Messages, statuses and codes are approved texts; numbers are asserted against the truth.
"""

from __future__ import annotations

import csv
import io
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labpipe.virtual_lab.tensile import build_twist_tube
from tests.approved import Approve
from tests.builders.bad_input import refused, told
from tests.builders.controldesk import Axis, Signal, write_mat_v5
from tests.builders.small_tests import Lab, Run, make_lab, small_scenario, state
from tests.builders.tensile_tests import TensileLab, make_tensile

LOAD_CELL = "Model Root/Load Cell"
Rows = list[list[str]]
Change = Callable[[Any], object]
ROLES = "{force: force.mat, markers: take.csv}"
HEAD = 8
"""Lines above the numbers in the export of a pull."""


@pytest.fixture
def lab(processed: Lab, tmp_path: Path) -> Lab:
    """A test with earlier results."""
    return processed.copy(tmp_path)


@pytest.fixture(scope="module")
def pulled(tmp_path_factory: pytest.TempPathFactory) -> TensileLab:
    """A twist tube with earlier results; not to be changed."""
    from labpipe.process.run import Task, process

    lab = make_tensile(tmp_path_factory.mktemp("done"), build_twist_tube("1b"))
    process(Task(lab.sheet, figures=False))
    assert len(state(lab.home / "processed")) == 2
    return lab


@pytest.fixture
def pull(pulled: TensileLab, tmp_path: Path) -> TensileLab:
    return pulled.copy(tmp_path)


def take(change: Callable[[Rows], Rows]) -> Change:
    """Change the rows of the take."""

    def changed(lab: Lab) -> None:
        path = lab.raw / "take.csv"
        rows = list(csv.reader(io.StringIO(path.read_text("utf-8"))))
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\r\n").writerows(change(rows))
        path.write_text(stream.getvalue(), encoding="utf-8", newline="")

    return changed


def names_of(rows: Rows) -> list[str]:
    return next(row for row in rows if len(row) > 1 and row[1] == "Name")


def without(*prefixes: str) -> Change:
    """Leave out the columns of some names."""

    def change(rows: Rows) -> Rows:
        kept = [not name.startswith(prefixes) for name in names_of(rows)]
        return [
            row if len(row) != len(kept) else [c for c, k in zip(row, kept, strict=True) if k]
            for row in rows
        ]

    return take(change)


def fill(name: str, cell: str, first: int = 7, last: int | None = None) -> Change:
    """Write one text into the columns of a name, in some rows of the take."""

    def change(rows: Rows) -> Rows:
        columns = [column for column, known in enumerate(names_of(rows)) if known == name]
        for row in rows[first:last]:
            for column in columns:
                row[column] = cell
        return rows

    return take(change)


def hold_clamp(start: float, stop: float) -> Change:
    """Hold the pose of the clamp for some seconds, as a body that is lost and kept."""

    def change(rows: Rows) -> Rows:
        columns = [column for column, name in enumerate(names_of(rows)) if name == "Clamp"]
        frames = [row for row in rows if row and row[0].isdecimal()]
        held = [row for row in frames if start <= float(row[1]) <= stop]
        for row in held[1:]:
            for column in columns:
                row[column] = held[0][column]
        return rows

    return take(change)


def swap_rows(rows: Rows) -> Rows:
    rows[300], rows[301] = rows[301], rows[300]
    return rows


def force(change: Callable[[np.ndarray, np.ndarray], object], name: str = "force.mat") -> Change:
    """Change times and volts of the recording, in place or for what is given back."""

    def changed(lab: Lab) -> None:
        from scipy.io import loadmat

        recording = loadmat(lab.raw / "force.mat", simplify_cells=True)["force"]
        signals = np.atleast_1d(recording["Y"])
        volts = next(signal["Data"] for signal in signals if signal["Path"] == LOAD_CELL)
        clock, volts = np.array(recording["X"]["Data"]), np.array(volts)
        part = change(clock, volts)
        kept = part if isinstance(part, slice) else slice(None)
        signal = Signal(LOAD_CELL, "Out1", volts[kept])
        write_mat_v5(lab.raw / name, [Axis(clock[kept])], [signal])

    return changed


def volts(at: slice, value: float) -> Change:
    """Set some samples of the force."""
    return force(lambda _, samples: samples.__setitem__(at, value))


def swap_times(clock: np.ndarray, _: np.ndarray) -> None:
    clock[[700, 701]] = clock[[701, 700]]


def make_holes(_: np.ndarray, samples: np.ndarray) -> None:
    samples[1500:1510], samples[2000] = np.nan, np.inf


def cut(name: str, share: float) -> Change:
    def change(lab: Lab) -> None:
        content = (lab.raw / name).read_bytes()
        (lab.raw / name).write_bytes(content[: int(share * len(content))])

    return change


def sheet(old: str, new: str) -> Change:
    return lambda lab: lab.edit("test.yaml", old, new)


def override(key: str, value: str) -> Change:
    return lambda lab: lab.override(key, value)


REFUSED: dict[str, Change] = {
    "take cut before its header": cut("take.csv", 0.0),
    "take cut in its header": cut("take.csv", 0.0005),
    "no rigid body": without("Clamp"),
    "body without a pose": fill("Clamp", ""),
    "two markers": without(*(f"Wire:Marker{number}" for number in range(3, 9))),
    "clamp that stands still": take(
        lambda rows: rows[:7] + [[*row[:2], *rows[7][2:]] for row in rows[7:]]
    ),
    "no sample is a number": volts(slice(None), np.nan),
    "force time runs backwards": force(swap_times),
    "frames run backwards": take(swap_rows),
    "misspelt channel": override("sources.force.channel", "Model Root/Laod Cell/Out1"),
    "gain without volts": override("sources.force.calibration.gain", "0.5 N"),
    "gain in mm": override("sources.force.calibration.gain", "0.5 mm/V"),
    "channel in mm": override("sources.force.unit", "mm"),
    "path out of the folder": sheet("force: force.mat", "force: '../../other/force.mat'"),
    "absolute path": sheet("force: force.mat", "force: '/etc/hostname'"),
    "path of Windows": sheet("force: force.mat", "force: 'C:\\lab\\force.mat'"),
    "no file": lambda lab: (lab.raw / "force.mat").unlink(),
    "files in each other's role": sheet(ROLES, "{force: take.csv, markers: force.mat}"),
    "role without a file": sheet(", markers: take.csv}", "}"),
    "role that the protocol does not know": sheet("markers: take.csv", "frame: take.csv"),
    "three parts that are one file": sheet(
        "force: force.mat", "force: [force.mat, force.mat, force.mat]"
    ),
    "parts of a take": sheet("markers: take.csv", "markers: [take.csv, take.csv]"),
    "sheet that is no YAML": sheet("files: {", "files: [{"),
    "misspelt protocol": sheet("wire-cantilever", "wire-cantilver"),
}


def test_links_are_followed_on_demand(
    lab: Lab, run: Run, tmp_path_factory: pytest.TempPathFactory
) -> None:
    outside = tmp_path_factory.mktemp("store") / "0001.mat"

    def link(lab: Lab) -> None:
        shutil.move(lab.raw / "force.mat", outside)
        (lab.raw / "force.mat").symlink_to(outside)

    assert "a link out of it" in refused(lab, run, link)[1]
    for command, *options in (("check",), ("process", "--no-figures")):
        assert run(command, lab.raw, *options).status == 2
        assert run(command, lab.raw, *options, "--follow-links").status == 0


def cut_in_line(*, is_late: bool) -> Change:
    """Cut the take within the first number of a line, or its last, which still reads as one."""

    def change(lab: Lab) -> None:
        path = lab.raw / "take.csv"
        content = path.read_bytes()
        line = content.rindex(b"\n", 0, int(0.66 * len(content)))
        end = content.index(b"\r\n", line + 1) - 2 if is_late else line + 3
        path.write_bytes(content[:end])

    return change


TOLD: dict[str, Change] = {
    "take cut in the first number of a line": cut_in_line(is_late=False),
    "take cut in the last number of a line": cut_in_line(is_late=True),
    "take cut while unloading": take(lambda rows: rows[:660]),
    "pose held in the second loading": hold_clamp(9.6, 10.5),
    "marker missing throughout": fill("Wire:Marker3", ""),
    "constant force": volts(slice(None), 0.25),
    "a stated offset of the clocks that is too large": override(
        "align", "{method: stated, offset: 3 s, because: a guess}"
    ),
    "no common time": force(lambda *_: slice(400)),
    "some samples missing": force(make_holes),
    "marker at infinity": fill("Wire:Marker2", "inf", 300, 320),
    "nothing moves": take(lambda rows: rows[:100]),
}


RARE = {"take cut in the first number of a line", "marker missing throughout", "nothing moves"}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in RARE else []) for name in TOLD]
)
def test_told(lab: Lab, run: Run, name: str, approved: Approve) -> None:
    approved(told(lab, run, TOLD[name]))
    peak, truth = lab.results["peak_displacement.1"], lab.truth["cycles"][0]
    if peak["value"] is not None:
        assert peak["value"] == pytest.approx(truth["peak_deflection"], abs=1e-3)


def test_one_cycle(tmp_path: Path, run: Run, approved: Approve) -> None:
    lab = make_lab(tmp_path, small_scenario(cycles=1))
    approved(told(lab, run))
    truth = lab.truth["cycles"][0]
    assert lab.results["peak_force.1"]["value"] == pytest.approx(truth["peak_force"], abs=3e-3)


@pytest.mark.slow
def test_two_parts_of_one_recording(lab: Lab, run: Run) -> None:
    assert run("process", lab.raw, "--no-figures").status == 0
    whole = lab.results
    for number, part in enumerate((slice(0, 1500), slice(1500, None))):
        force(lambda *_, part=part: part, f"part{number}.mat")(lab)
    sheet("force: force.mat", "force: [part0.mat, part1.mat]")(lab)
    assert run("process", lab.raw, "--no-figures").status == 0
    assert lab.results == whole


@pytest.mark.slow
def test_a_bad_test_does_not_stop_the_others(lab: Lab, run: Run) -> None:
    shutil.copytree(lab.raw, lab.raw.parent / "T0")
    (lab.raw.parent / "T0" / "force.mat").write_bytes(b"")
    ran = run("process", lab.raw.parent, "--no-figures")
    assert (ran.status, "T0" in ran.err) == (2, True)
    assert "T1  (wire-cantilever): 15 ok" in ran.out


def lines(change: Callable[[list[str]], list[str]]) -> Change:
    """Change the lines of the export of a pull."""

    def changed(lab: TensileLab) -> None:
        text = change(lab.export.read_bytes().decode("utf-8-sig").split("\r\n"))
        lab.export.write_bytes("\r\n".join(text).encode("utf-8-sig"))

    return changed


def swap(old: str, new: str) -> Change:
    return lambda lab: lab.edit(lab.export.name, old, new)


def files_line(lab: TensileLab, names: str) -> None:
    text = lab.sheet.read_text("utf-8")
    lab.sheet.write_text(f"{text[: text.index('files:')]}files: {{frame: {names}}}\n", "utf-8")


def twice(lab: TensileLab) -> None:
    (lab.raw / "again.txt").write_bytes(lab.export.read_bytes())
    files_line(lab, "[again.txt, 'DAQ- Crosshead, … - (Timed).txt']")


def without_units(lab: TensileLab) -> None:
    """A table of three columns whose names do not belong to the numbers below them."""
    export = lab.export.read_text("utf-8-sig").splitlines()[HEAD:]
    rows = [[float(cell) for cell in line.split("\t")] for line in export]
    lab.export.unlink()
    body = [f"{time},{travel},{1e3 * load}" for travel, load, time in rows]
    (lab.raw / "pull.csv").write_text("\n".join(["Time (s),Load,Crosshead", *body, ""]), "utf-8")
    files_line(lab, "pull.csv")
    lab.override("sources.frame.channels.force.unit", "N")
    lab.override("sources.frame.channels.displacement.unit", "mm")


PULLS_REFUSED: dict[str, Change] = {
    "columns swapped beside their units": swap("Crosshead \tLoad ", "Load \tCrosshead "),
    "no such channel": swap("Crosshead \tLoad ", "Crosshead \tLast "),
    "three rows": lines(lambda text: [*text[: HEAD + 3], ""]),
    "part given twice": twice,
    "part that is missing": lambda lab: lab.export.unlink(),
    "unit that contradicts the export": override("sources.frame.channels.force.unit", "N"),
}
PULLS_TOLD: dict[str, Change] = {
    "kilonewtons taken for newtons": swap("mm\tkN\tsec", "mm\tN\tsec"),
    "columns swapped without units": without_units,
    "never failed": lines(lambda text: [*text[:480], ""]),
    "two displacements": lines(
        lambda text: [*text[:6], *map("{}\t{}".format, text[6:-1], ["Stroke ", "mm", *range(9999)])]
    ),
    "window beyond the travel": override("results.stiffness_second.to", "80 mm"),
    "modulus without sizes": override(
        "results.8", "{result: modulus, of: stiffness_first, area: stated}"
    ),
    "stroke too long": override("branches.min_stroke", "200 mm"),
}


@pytest.mark.parametrize("name", [*REFUSED, *PULLS_REFUSED])
def test_refused(request: pytest.FixtureRequest, run: Run, name: str, approved: Approve) -> None:
    lab = request.getfixturevalue("pull" if name in PULLS_REFUSED else "lab")
    n_faults = 1 + name.startswith(("role that", "columns swapped beside"))
    approved(refused(lab, run, (REFUSED | PULLS_REFUSED)[name], n_faults))


@pytest.mark.parametrize("name", PULLS_TOLD)
def test_pull_told(pull: TensileLab, run: Run, name: str, approved: Approve) -> None:
    approved(told(pull, run, PULLS_TOLD[name]))


def test_a_unit_in_the_export_that_is_said_to_be_wrong(pull: TensileLab, run: Run) -> None:
    assert run("process", pull.raw, "--no-figures").status == 0
    newtons = pull.results["peak_force.1"]["value"]
    pull.override("sources.frame.channels.force.unit", "lbf")
    pull.override("sources.frame.channels.force.wrong_unit_in_file", "kN")
    assert run("process", pull.raw, "--no-figures").status == 0
    assert pull.results["peak_force.1"]["value"] == pytest.approx(4.448222e-3 * newtons, rel=0.01)
    assert re.match("the export states 'kN', the protocol 'lbf'", pull.notes["unit_overridden"])
