"""The watch on a campaign: real files with a clock of its own, a process of its own, verdicts."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from docs.site.reference_pages import list_note_kinds
from labpipe.campaign.campaign_files import find_campaign
from labpipe.campaign.catalog import Entry, TestRow, open_catalog
from labpipe.campaign.decisions import Decision
from labpipe.campaign.executors import Outcome
from labpipe.campaign.pairing import pair_test
from labpipe.campaign.running import read_overview, record_decision
from labpipe.campaign.watching import (
    WatchedCampaign,
    Watcher,
    describe_test,
    read_actions,
)
from labpipe.errors import CODES
from labpipe.process.run import ProcessedTest, RefusedTest
from labpipe.records.quality import Severity
from labpipe.records.result import Result, Specimen, TestResult
from labpipe.store.layout import ResultRow
from tests.builders.lab_campaigns import LabCampaign
from tests.builders.small_tests import Lab

PLAN = """\
version: 1
protocol: wire-cantilever
pair: {name: "{type}-{length mm}-{sample}"}
specimen: {spool: s}
"""


PROTOCOL = "{version: 1, name: p, sources: {force: {reader: dspace-mf4, channel: a}}}"


def make_result(*results: Result) -> TestResult:
    """Results of a test without anything else."""
    specimen = Specimen("A2", "s", "1")
    none = (None, None, None)
    return TestResult("T", specimen, "p", PROTOCOL, "", "", (), {}, *none, results, ())


@dataclass
class Campaign(WatchedCampaign):
    """A campaign whose tests are processed by saying so."""

    home: Path
    asked: list[str] = field(default_factory=list)
    done: list[str] = field(default_factory=list)
    fails: dict[str, str] = field(default_factory=dict)
    trouble: list[Exception] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.raw = self.home / "raw" / "c"

    def was_processed(self, sheet: Path) -> bool:
        return sheet.parent.name in self.done

    def process(self, sheet: Path, *, is_forced: bool = False) -> Outcome | None:
        name = sheet.parent.name
        self.asked.append(name)
        if self.trouble:
            raise self.trouble.pop()
        folder = self.home / "processed" / "c" / name
        if name in self.fails:
            return RefusedTest(sheet, self.fails[name], "x.mat: expected a. Do.", folder)
        if name in self.done and not is_forced:
            return None
        self.done.append(name)
        return ProcessedTest(folder, make_result(Result("peak_force.1", 1.0, "N")), ())

    def read_group_values(self, sheet: Path) -> dict[str, list[float]]:
        return {"peak_force.1": [1.0 for name in self.done if name != sheet.parent.name]}


@dataclass
class Bench:
    """A watch, what it said, and a clock that goes when it is told to."""

    campaign: Campaign
    now: float = 1000.0
    said: list[str] = field(default_factory=list)
    drawn: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.watcher = self.begin()

    def begin(self) -> Watcher:
        return Watcher(
            self.campaign,
            pair=pair_test,
            draw=lambda folder: self.drawn.append(folder.name),
            show_message=self.said.append,
            clock=lambda: self.now,
        )

    def go(self, seconds: float, step: float = 0.5) -> str:
        """Scan every half second; return the messages of that time."""
        n_messages, end = len(self.said), self.now + seconds
        while self.now < end:
            while self.watcher.scan():
                pass
            self.now += step
        return "\n".join(self.said[n_messages:])


@pytest.fixture(scope="module")
def exports(pristine: Lab) -> dict[str, bytes]:
    return {name: (pristine.raw / name).read_bytes() for name in ("force.mat", "take.csv")}


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    campaign = Campaign(tmp_path)
    campaign.raw.mkdir(parents=True)
    (campaign.raw / "campaign.yaml").write_text(PLAN, encoding="utf-8")
    return Bench(campaign)


def put(bench: Bench, test: str, exports: dict[str, bytes], *names: str) -> Path:
    folder = bench.campaign.raw / test
    folder.mkdir(exist_ok=True)
    for name in names or exports:
        (folder / name).write_bytes(exports[name])
    return folder


def test_watch_pairs_processes_and_judges_a_test_once(
    bench: Bench, exports: dict[str, bytes]
) -> None:
    assert bench.go(5) == ""
    put(bench, "A2-085-1", exports)
    messages = bench.go(3).splitlines()
    assert messages[0] == "A2-085-1: wrote A2-085-1/test.yaml"
    assert messages[-3:] == [
        "A2-085-1: OK, 1 ok",
        "  peak_force.1 1 N; first of its group",
        "  nothing to check: the specimen can be dismounted",
    ]
    assert bench.drawn == ["A2-085-1"]
    assert bench.go(20) == ""
    assert bench.campaign.asked == ["A2-085-1"]
    put(bench, "A2-085-2", exports)
    assert "(so far 1); n = 1 so far, too few to judge" in bench.go(3)


@pytest.mark.slow
def test_unreadable_file_is_reported_and_read_later(
    bench: Bench, exports: dict[str, bytes]
) -> None:
    folder = put(bench, "A2-085-1", exports)
    (folder / "force.mat").write_bytes(exports["force.mat"][:5000])
    assert bench.go(50, step=5) == ""
    message = bench.go(30, step=5)
    assert message.startswith(
        "A2-085-1: force.mat cannot be read yet (expected a complete MAT v5 file"
    )
    assert bench.go(3600, step=30) == ""
    (folder / "force.mat").write_bytes(exports["force.mat"])
    assert "OK" in bench.go(3)


def test_locked_file_is_reported_and_awaited(
    bench: Bench, exports: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    put(bench, "A2-085-1", exports)
    with monkeypatch.context() as patch:
        patch.setattr("labpipe.campaign.watching._can_open", lambda path: path.suffix != ".mat")
        assert bench.go(59, step=1) == ""
        assert bench.go(10, step=1) == (
            "A2-085-1: force.mat cannot be opened, another program uses it; waiting for it"
        )
        assert bench.go(3600, step=30) == ""
    assert "OK" in bench.go(3)


def test_files_are_awaited_while_they_change(bench: Bench, exports: dict[str, bytes]) -> None:
    folder = put(bench, "A2-085-1", exports)
    for count in (1, 2, 3):
        (folder / "take.csv").write_bytes(exports["take.csv"][: 1000 * count])
        assert bench.go(0.9, step=0.1) == ""
    (folder / "take.csv").write_bytes(exports["take.csv"])
    os.utime(folder / "force.mat", (1.0, 1.0))  # it changes at the same size
    assert bench.go(0.9, step=0.1) == ""
    (folder / "take.csv").unlink()
    assert bench.go(10) == "A2-085-1: waits for markers"
    put(bench, "A2-085-1", exports)
    assert bench.go(0.9, step=0.1) == ""
    assert "A2-085-1: OK" in bench.go(1.0, step=0.1)
    assert bench.campaign.asked == ["A2-085-1"]


def test_lost_folder_is_reported_once_and_awaited(bench: Bench, exports: dict[str, bytes]) -> None:
    put(bench, "A2-085-1", exports)
    bench.go(3)
    away = bench.campaign.home / "away"
    bench.campaign.raw.rename(away)
    assert bench.go(30) == f"{bench.campaign.raw}: no such file or directory; waiting for it"
    away.rename(bench.campaign.raw)
    put(bench, "A2-085-2", exports)
    messages = bench.go(6)
    assert messages.startswith(f"{bench.campaign.raw}: available again\n")
    assert "A2-085-2: OK" in messages
    assert bench.campaign.asked == ["A2-085-1", "A2-085-2"]


def test_corrected_test_is_processed_again(bench: Bench, exports: dict[str, bytes]) -> None:
    bench.campaign.fails = {"A2-085-1": "cannot_process"}
    (bench.campaign.raw / "campaign.yaml").write_text(
        PLAN.replace("specimen: {spool: s}\n", ""), encoding="utf-8"
    )
    sheet = put(bench, "A2-085-1", exports) / "test.yaml"
    message = bench.go(20)
    assert message.startswith("campaign.yaml was read again")
    assert message.splitlines()[-1] == "  to fill in: spool; the test is then processed"
    assert bench.campaign.asked == []
    text = sheet.read_text("utf-8").replace("spool:   # to be filled in", "spool: s")
    sheet.write_text(text, "utf-8")
    assert bench.go(20).splitlines()[-3:] == [
        "A2-085-1: FAILED (cannot_process)",
        "  x.mat: expected a. Do.",
        "  while it is mounted: correct the test sheet; the test is then processed",
    ]
    bench.campaign.fails = {}
    sheet.write_text(text + "# corrected\n", "utf-8")
    assert "A2-085-1: OK" in bench.go(4)


def test_corrected_plan_is_tried_at_once(bench: Bench, exports: dict[str, bytes]) -> None:
    plan = bench.campaign.raw / "campaign.yaml"
    plan.write_text(PLAN.replace("wire-cantilever", "unknown"), encoding="utf-8")
    put(bench, "A2-085-1", exports)
    assert bench.go(20) != ""
    assert bench.campaign.asked == []
    plan.write_text(PLAN, encoding="utf-8")
    assert "A2-085-1: OK" in bench.go(4)


def test_restarted_watch_repeats_nothing(bench: Bench, exports: dict[str, bytes]) -> None:
    for number in (1, 2):
        put(bench, f"A2-085-{number}", exports)
    bench.go(10)
    put(bench, "A2-085-3", exports)  # while no watch was there
    n_messages = len(bench.said)
    bench.watcher = bench.begin()
    bench.go(10)
    assert sorted(bench.campaign.asked) == ["A2-085-1", "A2-085-2", "A2-085-3"]
    verdicts = [sentence for sentence in bench.said[n_messages:] if "OK" in sentence]
    assert len(verdicts) == 1


PLAN_OF_ONE = """\
version: 1
protocol: wire-cantilever
specimen: {type: A2, spool: A2-s1, sample: 1, length: 85 mm}
overrides:
  rig.stroke: {value: 12 mm, because: a short stroke}
  rig.cycles: {value: 2, because: set so}
  rig.crosshead_speed: {value: 4 mm/s, because: set so}
"""
_COMMAND = (
    "import signal, sys; from labpipe.cli import main;"
    " signal.signal(signal.SIGINT, signal.default_int_handler);"  # a job in the background
    " sys.exit(main(sys.argv[1:]))"
)


def wait_for(process: subprocess.Popen[str], text: str) -> str:
    for line in process.stdout or ():
        if text in line:
            return line.rstrip("\n")
    raise AssertionError(text)


@pytest.fixture
def watch(lab: Lab) -> Iterator[subprocess.Popen[str]]:
    """`labpipe campaign watch` in a process of its own, which is killed after two minutes."""
    (lab.raw.parent / "campaign.yaml").write_text(PLAN_OF_ONE, encoding="utf-8")
    exports = lab.raw.rename(lab.home / "exports")
    (exports / "test.yaml").unlink()
    process = subprocess.Popen(
        [sys.executable, "-c", _COMMAND, "campaign", "watch", str(lab.raw.parent)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    timer = threading.Timer(120.0, process.kill)
    timer.start()
    with process:
        yield process
        timer.cancel()
        process.kill()


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals are another matter on Windows")
def test_from_the_end_of_a_recording_to_figures(lab: Lab, watch: subprocess.Popen[str]) -> None:
    campaign = lab.raw.parent
    wait_for(watch, "; press Ctrl+C to stop")
    (lab.home / "exports").rename(campaign / "T7")
    wait_for(watch, "T7: wrote T7/test.yaml")
    assert "OK" in wait_for(watch, "T7: ")
    assert wait_for(watch, "peak_force.1 ").endswith("; first of its group")
    wait_for(watch, "  nothing to check: the specimen can be dismounted")
    figures = lab.home / "processed" / "c" / "T7" / "figures"
    while not figures.exists() and watch.poll() is None:
        time.sleep(0.1)
    watch.send_signal(signal.SIGINT)
    wait_for(watch, "labpipe: interrupted; earlier results are unchanged")
    assert watch.wait() == 130
    assert len(list(figures.iterdir())) == 6
    overview = read_overview(find_campaign(campaign))
    assert {name: row.state for name, row in overview.rows.items()} == {"T7": "ok"}


def lines(peak: float, peaks: Sequence[float] = ()) -> list[str]:
    names = ("peak_force.1", "peak_force.2")
    test = make_result(Result("energy.1", 2.0, "J"), *(Result(name, peak, "N") for name in names))
    values = {"peak_force.1": peaks, "peak_force.2": peaks, "energy.1": [2.0] * len(peaks)}
    return describe_test("T", replace(test, display={"force": "mN"}), values, ("peak_force.1",))


def test_result_outside_its_group_is_reported() -> None:
    peaks = [1.0 + 0.01 * i for i in range(-3, 4)]
    head, numbers, text = lines(1.2, peaks)
    assert head == "T: CHECK, 3 ok, outside the group: peak_force.1"
    # 1 +- t(6 degrees, 1 - 0.05 / 6) * 0.0216 * sqrt(1 + 1 / 7), with t = 3.2875
    assert "peak_force.1 1200 mN (OUTSIDE 924.1 to 1076); " in numbers
    assert numbers.endswith("; n = 7 so far")
    assert text.startswith("  while it is mounted: compare the set-up with that of the other tests")
    assert "(within 924.1 to 1076)" in lines(1.07, peaks)[1]


def test_group_values_exclude_the_test_itself(tmp_path: Path) -> None:
    campaign = LabCampaign(tmp_path)
    for name, export in (("T1", "1"), ("T2", "2"), ("T3", "3"), ("D", "doubt"), ("F", "fail bad")):
        campaign.add(name, export)
    campaign.run()
    record_decision(campaign.folders, "T3", Decision("", "", "reject", "slipped", "AT"))
    watched = WatchedCampaign(campaign.folders, campaign.stand_in)
    assert watched.read_group_values(campaign.raw / "T1" / "test.yaml") == {"peak_force.1": [2.0]}


def test_group_has_one_protocol_and_specimen(tmp_path: Path) -> None:
    specimens = ('{"length": 1.0}', '{"length": 1.0, "sample": "2"}', '{"length": 2.0}')
    with closing(open_catalog(tmp_path, [])) as catalog:
        for value, specimen in enumerate(specimens):
            result = ResultRow("a", value, value, None, None, "N", None, "ok", "", "")
            row = TestRow(str(value), run="r", protocol="p", specimen=specimen)
            other_row = row._replace(folder=f"q{value}", protocol="q")
            catalog.write_entries(Entry(test, results=(result,)) for test in (row, other_row))
        assert [catalog.read_group_values(folder) for folder in "02"] == [{"a": [1.0]}, {}]


def test_every_code_that_doubts_or_fails_has_an_action(repository: Path) -> None:
    doubting = {
        kind.code
        for kind in list_note_kinds()
        if kind.origin == "processing" and (kind.doubts or Severity.ERROR in kind.severities)
    }
    page = (repository / "docs" / "reference" / "results.md").read_text(encoding="utf-8")
    table = page.partition("## Reason codes of failed results")[2].partition("In a [report]")[0]
    failing = set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE))
    listed_codes = set(re.findall(r"`(\w+)`", table))

    missing = (doubting | failing | set(CODES)) - set(read_actions()) - {"mid_span", "code"}
    assert not missing
    known_codes = {kind.code for kind in list_note_kinds()} | listed_codes | set(CODES)
    assert not set(read_actions()) - known_codes  # no action for a code that there is not
