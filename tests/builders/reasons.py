"""Reasons and doubts of the results of a test, and which run its files are of."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from labpipe.records.quality import Finding, Findings
from labpipe.results.kinds import ReducedTest
from labpipe.store.result_files import read_run


def codes(result: Mapping[str, Any]) -> list[str]:
    """Codes of the reasons of a result."""
    return [entry["code"] for entry in result["reasons"]]


def why(result: Mapping[str, Any]) -> str:
    """Codes and sentences of the reasons of a result, as the commands print them."""
    return "; ".join(f"{entry['code']}: {entry['message']}" for entry in result["reasons"])


def doubted(reduced: ReducedTest | Iterable[Finding]) -> dict[str, str]:
    """The first reason of each quantity that is in doubt anywhere in the record."""
    findings = reduced.findings if isinstance(reduced, ReducedTest) else Findings() + reduced
    reasons: dict[str, str] = {}
    for doubt in findings.doubts:
        reasons.setdefault(doubt.quantity, str(doubt.reason))
    return reasons


def runs(folder: Path) -> set[str]:
    """Keys of the run that the files of a test show: result, summary, figures as SVG and PNG."""
    keys = {json.loads((folder / "summary.json").read_text("utf-8"))["run"]}
    keys.add(read_run(folder / "result.h5"))
    for figure in (folder / "figures").iterdir():
        content = figure.read_bytes()
        key = rb"<dc:identifier>(\w{64})</dc" if figure.suffix == ".svg" else rb"run\x00(\w{64})"
        keys |= {entry.decode() for entry in re.findall(key, content)}
        assert re.search(key, content), figure
    return keys
