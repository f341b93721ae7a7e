"""Which tests run which lines of the layers, and how long each takes: made once, kept in build/.

As a plugin of pytest (``-p tests.mutation.entered``) it writes down what is read here.
"""

from __future__ import annotations

import gc
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import Any

import pytest
from coverage import Coverage, CoverageData

from tests.mutation.mutants import LAYERS, Mutant

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = REPOSITORY / "labpipe"
KEPT = REPOSITORY / "build" / "mutation"
LONGEST, SECONDS = 20.0, 40.0
"""Of processor time: of a test that is asked, and of all that are asked for a mutant."""


def record() -> None:
    """Run the tests that have changed since they were last run here, but for slow ones.

    All tests where a module of the layers has changed: its lines may be others.
    """
    parts = sorted(KEPT.glob("*.json"))
    made = max((part.stat().st_mtime for part in parts), default=0.0)
    modules = [path for layer in LAYERS for path in (PACKAGE / layer).rglob("*.py")]
    if any(path.stat().st_mtime > made for path in modules):
        shutil.rmtree(KEPT, ignore_errors=True)
        made = 0.0
    tests = (REPOSITORY / "tests").rglob("test_*.py")
    if changed := [str(path) for path in tests if path.stat().st_mtime > made]:
        KEPT.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.mutation.entered"]
        options = ["-p", "no:randomly", "-n", "2", "--dist", "loadfile"]
        subprocess.run([*command, *options, *changed], cwd=REPOSITORY, check=False)


@dataclass(frozen=True)
class Entered:
    """Tests by the lines that they run.

    Parameters
    ----------
    data : lines by module and test, as coverage keeps them
    seconds : of processor time that each test took
    """

    data: CoverageData
    seconds: Mapping[str, float]

    @classmethod
    def kept(cls) -> Entered:
        """What was recorded; recorded again where tests have changed."""
        record()
        data, seconds = CoverageData(no_disk=True), dict[str, float]()
        for path in sorted(KEPT.glob("*.json")):
            seconds |= json.loads(path.read_text(encoding="utf-8"))
            part = CoverageData(str(path.with_suffix(".coverage")))
            part.read()
            data.update(part)
        return cls(data, seconds)

    def tests_of(self, mutant: Mutant, last: str = "") -> list[str]:
        """Tests that run the statement of a mutant, then those beside them, each fastest first.

        What a test beside them looks at may have been made for the first of its file. A test that
        noticed the fault last time comes before all; those above `LONGEST` are left out, and what
        would make all take more than `SECONDS`.
        """
        by_line = self.data.contexts_by_lineno(str(PACKAGE / mutant.module))
        lines = mutant.lines or by_line
        entering = {test for line in lines for test in by_line.get(line, ()) if test}
        files = {test.partition("::")[0] for test in entering}
        quick = {test for test, seconds in self.seconds.items() if seconds <= LONGEST}
        beside = {test for test in quick if test.partition("::")[0] in files} - entering
        tests = sorted(
            entering & quick | beside,
            key=lambda test: (test != last, test in beside, self.seconds[test]),
        )
        total = accumulate(self.seconds[test] for test in tests)
        return [test for test, until in zip(tests, total, strict=True) if until <= SECONDS]


class _Recorder:
    """Follows the lines of each test, and its time."""

    def __init__(self) -> None:
        self.path = KEPT / f"{time.time_ns()}.json"
        include = [f"{PACKAGE}/{layer}/*" for layer in LAYERS]
        self.coverage = Coverage(
            data_file=str(self.path.with_suffix(".coverage")), include=include, config_file=False
        )
        self.seconds: dict[str, float] = {}
        self.failed: set[str] = set()
        self.coverage.start()

    @cached_property
    def caches(self) -> list[Any]:
        """Functions of the package that remember what they returned."""
        return [
            thing
            for thing in gc.get_objects()
            if type(thing).__name__ == "_lru_cache_wrapper"
            and thing.__module__.startswith("labpipe.")
        ]

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        for cached in self.caches:
            cached.cache_clear()
        self.coverage.switch_context(item.nodeid)
        began = sum(os.times()[:4])
        yield
        self.seconds[item.nodeid] = sum(os.times()[:4]) - began
        self.coverage.switch_context("")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:  # without any fault: it tells nothing
            self.failed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        self.coverage.stop()
        self.coverage.save()
        if self.seconds:
            sound = {name: self.seconds[name] for name in self.seconds.keys() - self.failed}
            self.path.write_text(json.dumps(sound), encoding="utf-8")


@pytest.hookimpl(tryfirst=True)
def pytest_load_initial_conftests(early_config: pytest.Config) -> None:
    early_config.pluginmanager.register(_Recorder(), "entered")
