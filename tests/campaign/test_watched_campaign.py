"""The watch as a process of its own, on exports that come in pieces."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from labpipe.campaign.campaign_folders import find_campaign
from labpipe.campaign.executors import local
from labpipe.campaign.running import look
from labpipe.campaign.watched_campaign import WatchedCampaign
from labpipe.errors import ProcessingError
from labpipe.virtual_lab import CantileverScenario, simulate_test
from tests.builders.small_tests import Lab, state

PLAN = """\
version: 1
protocol: wire-cantilever
specimen: {type: A2, spool: A2-s1, sample: 1, length: 85 mm}
overrides:
  rig.stroke: {value: 12 mm, because: a short stroke}
  rig.cycles: {value: 2, because: set so}
  rig.crosshead_speed: {value: 4 mm/s, because: set so}
"""
LONGEST = 5.0
"""s, from the end of a recording to the verdict."""
_COMMAND = (
    "import signal, sys; from labpipe.cli import main;"
    " signal.signal(signal.SIGINT, signal.default_int_handler);"  # a job in the background
    " sys.exit(main(sys.argv[1:]))"
)


class Watch:
    """`labpipe campaign watch` in a process of its own."""

    def __init__(self, folder: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", _COMMAND, "campaign", "watch", str(folder)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )
        self.lines: queue.Queue[str] = queue.Queue()
        self.said: list[str] = []
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        for line in self.process.stdout or ():
            self.lines.put(line.rstrip("\n"))

    def wait_for(self, words: str, seconds: float = 120.0) -> str:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            try:
                line = self.lines.get(timeout=0.1)
            except queue.Empty:
                assert self.process.poll() is None, "\n".join(self.said)
                continue
            self.said.append(line)
            if words in line:
                return line
        raise AssertionError(f"no {words!r} in {self.said}")

    def interrupt(self) -> int:
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(60)


@pytest.fixture
def begun() -> Iterator[list[Watch]]:
    """Watches that are ended with the test."""
    watches: list[Watch] = []
    yield watches
    for each in watches:
        if each.process.poll() is None:
            each.process.kill()
        each.process.wait(10)
        if each.process.stdout is not None:
            each.process.stdout.close()


def put_in_pieces(source: Path, goal: Path, names: tuple[str, ...], *, pieces: int) -> float:
    """Write exports as a program does; gives the time at which the last one ends."""
    goal.mkdir(parents=True)
    for name in names:
        data = (source / name).read_bytes()
        with (goal / name).open("wb") as stream:
            for start in range(0, len(data), len(data) // pieces + 1):
                stream.write(data[start : start + len(data) // pieces + 1])
                stream.flush()
                time.sleep(0.05)
    return time.monotonic()


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals are another matter on Windows")
def test_from_the_end_of_a_recording_to_figures(lab: Lab, begun: list[Watch]) -> None:
    campaign = lab.raw.parent
    exports = lab.raw.rename(lab.home / "exports")
    (campaign / "campaign.yaml").write_text(PLAN, encoding="utf-8")
    begun.append(Watch(campaign))
    begun[0].wait_for("; Ctrl-C ends it")

    put_in_pieces(exports, campaign / "T7", ("force.mat", "take.csv"), pieces=10)

    begun[0].wait_for("T7: wrote T7/test.yaml")
    assert "WELL" in begun[0].wait_for("T7: ")
    assert begun[0].wait_for("peak_force.1 ").endswith("; the first of its group")
    begun[0].wait_for("  nothing to look at: the specimen can come off")
    figures = lab.home / "processed" / "c" / "T7" / "figures"
    until = time.monotonic() + 60.0
    while not figures.exists() and time.monotonic() < until:
        time.sleep(0.1)
    assert begun[0].interrupt() == 130
    begun[0].wait_for("labpipe: interrupted; earlier results are as they were")
    assert len(list(figures.iterdir())) == 6
    overview = look(find_campaign(campaign))
    assert {name: row.state for name, row in overview.rows.items()} == {"T7": "ok"}

    before = state(lab.home / "processed" / "c" / "T7")
    begun.append(Watch(campaign))
    put_in_pieces(exports, campaign / "T8", ("take.csv", "force.mat"), pieces=10)
    begun[1].wait_for("T8: WELL")
    begun[1].wait_for("nothing to look at")
    assert begun[1].interrupt() == 130
    assert not [line for line in begun[1].said if "T7: " in line]
    assert state(lab.home / "processed" / "c" / "T7") == before


def delay_of(processes: list[int]) -> float:
    """Time for which the busiest threads of processes had to wait for a processor, s."""
    total = 0.0
    for process in processes:
        threads = Path(f"/proc/{process}/task").glob("*/schedstat")
        total += max(int(each.read_text().split()[1]) for each in threads) / 1e9
    return total


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="it asks how long processes had to wait")
def test_a_verdict_within_five_seconds(tmp_path: Path, begun: list[Watch]) -> None:
    """Full size: 330 s of 10 kHz and 50 frames per second, 72 MB in growing pieces.

    The time that processes of others kept ours from running is taken off. On a machine with much
    else to do, processors also work more slowly, and nothing is measured.
    """
    if os.getloadavg()[0] > (os.cpu_count() or 1):
        pytest.skip("the machine is busy: what is measured would be that of others")
    simulate_test(CantileverScenario(), tmp_path / "exports", 1)
    campaign = tmp_path / "raw" / "c"
    campaign.mkdir(parents=True)
    (campaign / "campaign.yaml").write_text("version: 1\nspecimen: {spool: s}\n", encoding="utf-8")
    begun.append(Watch(campaign))
    begun[0].wait_for("; Ctrl-C ends it")
    time.sleep(15.0)  # longer than imports take
    children = Path(f"/proc/{begun[0].process.pid}/task/{begun[0].process.pid}/children")
    ours = [begun[0].process.pid, *map(int, children.read_text().split())]

    ended = put_in_pieces(
        tmp_path / "exports", campaign / "A2-085-1", ("take.csv", "force.mat"), pieces=40
    )
    delayed = delay_of(ours)
    begun[0].wait_for("A2-085-1: WELL")
    taken, delayed = time.monotonic() - ended, delay_of(ours) - delayed

    assert taken - delayed <= LONGEST, f"{taken:.2f} s, {delayed:.2f} s of it without a processor"


@pytest.mark.slow
def test_a_test_that_another_labpipe_processes_is_tried_again(lab: Lab) -> None:
    folders = find_campaign(lab.raw.parent)
    watched = WatchedCampaign(folders, local(1))
    from labpipe.campaign.refreshing import opened_campaign

    with opened_campaign(folders) as keeper:
        keeper.refresh()
        assert keeper.catalog.claim("T1")
        with pytest.raises(ProcessingError, match=r"another labpipe at work on it"):
            watched.process(lab.sheet)
        keeper.catalog.release("T1")
    outcome = watched.process(lab.sheet)
    assert outcome is not None
    assert outcome.state == "ok"
    assert watched.process(lab.sheet) is None
    assert watched.process(lab.sheet, again=True) is not None
    assert watched.unprocessed([lab.sheet]) == []
    assert list(watched.results()) == [lab.processed.resolve()]
