"""Tests that a change has spoiled, put through the command: refused, or told as doubtful."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from labpipe.errors import CODES
from tests.builders.small_tests import LabFolder, Run, state

L = TypeVar("L", bound=LabFolder)


@dataclass(frozen=True)
class Refused(Generic[L]):
    """Process a test after a change that makes it unusable; give the message, a line per fault."""

    lab: L
    run: Run

    def __call__(self, change: Callable[[L], object], faults: int = 1) -> str:
        change(self.lab)
        raw, earlier = state(self.lab.home / "raw"), state(self.lab.home / "processed")
        assert earlier
        ran = self.run("process", self.lab.raw)
        assert (ran.status, ran.out) == (2, ""), ran
        assert state(self.lab.home / "raw") == raw
        _, _, message = ran.err.partition("labpipe process: ")
        after = state(self.lab.home / "processed")
        failure_file = after.pop(f"c/{self.lab.name}/failure.json")
        assert after == earlier
        assert failure_file
        failure = json.loads((self.lab.processed / "failure.json").read_text("utf-8"))
        assert f"{failure['reason']}\n" == message
        assert failure["code"] in CODES
        # *file, place: expected X, found Y. What to do.*, in one line
        grammar = r"[^\n]+?: expected [^\n]+?, found [^\n]+\. [^\n]+[.?)]\n"
        assert re.fullmatch(f"({grammar}){{{faults}}}", message), message
        return message


@dataclass(frozen=True)
class Told(Generic[L]):
    """Process a test after a change that costs results, not the test; raw files stay."""

    lab: L
    run: Run

    def __call__(self, change: Callable[[L], object], status: int | None = None) -> L:
        change(self.lab)
        raw = state(self.lab.home / "raw")
        ran = self.run("process", self.lab.raw, "--no-figures")
        results = self.lab.results.values()
        failed = any(finding["status"] == "failed" for finding in results)
        assert ran.status == int(failed), ran
        assert status in (None, ran.status)
        assert "Traceback" not in ran.err
        assert state(self.lab.home / "raw") == raw
        for result in results:
            assert result["status"] == "ok" or result["reasons"], result
            for reason in result["reasons"]:
                assert re.fullmatch(r"[a-z][a-z0-9_]*", reason["code"]), result
                assert reason["message"].strip(), result
        return self.lab
