"""Tests that a change has spoiled, put through the command: refused, or told as doubtful."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import TypeVar

from labpipe.errors import CODES
from tests.builders.small_tests import LabFolder, Run, state

L = TypeVar("L", bound=LabFolder)


def refused(lab: L, run: Run, change: Callable[[L], object], faults: int = 1) -> tuple[str, str]:
    """Process a test that a change makes unusable; give code and message, a line per fault."""
    change(lab)
    raw, earlier = state(lab.home / "raw"), state(lab.home / "processed")
    assert earlier
    ran = run("process", lab.raw)
    assert (ran.status, ran.out) == (2, ""), ran
    assert state(lab.home / "raw") == raw
    _, _, message = ran.err.partition("labpipe process: ")
    after = state(lab.home / "processed")
    del after[f"c/{lab.name}/failure.json"]
    assert after == earlier
    failure = json.loads((lab.processed / "failure.json").read_text("utf-8"))
    assert f"{failure['reason']}\n" == message
    assert failure["code"] in CODES
    # *file, place: expected X, found Y. What to do.*, in one line
    grammar = r"[^\n]+?: expected [^\n]+?, found [^\n]+\. [^\n]+[.?)]\n"
    assert re.fullmatch(f"({grammar}){{{faults}}}", message), message
    return failure["code"], message


def told(lab: L, run: Run, change: Callable[[L], object] = id) -> list[str]:
    """Process a test that a change costs results; give statuses and codes of results and notes."""
    change(lab)
    raw = state(lab.home / "raw")
    ran = run("process", lab.raw, "--no-figures")
    results = lab.results
    assert ran.status == int(any(result["status"] == "failed" for result in results.values())), ran
    assert "Traceback" not in ran.err
    assert state(lab.home / "raw") == raw
    assert "Infinity" not in (lab.processed / "summary.json").read_text("utf-8")
    lines = []
    for name, result in results.items():
        codes = [reason["code"] for reason in result["reasons"]]
        assert (result["status"] == "ok") == (not codes), result
        assert all(reason["message"].strip() for reason in result["reasons"]), result
        lines.append(" ".join((name, result["status"], *codes)))
    codes = sorted({note["code"] for note in lab.summary["quality"]})
    return [*lines, f"notes: {', '.join(codes)}"]
