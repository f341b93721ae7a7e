"""Three lines on a new test: status, numbers, and actions at the bench."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from math import sqrt
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from labpipe.campaign.catalog_rows import TestRow
from labpipe.errors import LabpipeError
from labpipe.protocol.load import load_test_sheet, resolve
from labpipe.report.wording import shown_in
from labpipe.statistics.means import t_quantile

MAX_NUMBERS: Final = 3
"""Numbers in a verdict."""

_Entry: TypeAlias = Mapping[str, Any]
"""A result in summary.json."""
Values: TypeAlias = Mapping[str, Sequence[float]]
"""Values of several tests by result."""


def make_group_key(row: TestRow) -> str:
    """Return the group of a test: its protocol and specimen, except spool and sample.

    Parameters
    ----------
    row : of the test
    """
    # Fields of the specimen that may differ within a group.
    ignored_fields = ("spool", "sample", "uncertainty")
    specimen = json.loads(row.specimen)
    fields = {key: value for key, value in specimen.items() if key not in ignored_fields}
    return json.dumps([row.protocol, fields], sort_keys=True)


@dataclass(frozen=True, slots=True)
class DisplaySettings:
    """Display settings of a test.

    Parameters
    ----------
    display : unit by quantity
    main : results by which the protocol compares groups, in order
    """

    display: Mapping[str, str] = field(default_factory=dict)
    main: tuple[str, ...] = ()


def read_display_settings(sheet: Path) -> DisplaySettings:
    """Read the display settings of a test from its protocol.

    Parameters
    ----------
    sheet : its test.yaml; if unreadable, SI is used
    """
    with suppress(LabpipeError, OSError):
        protocol = resolve(load_test_sheet(sheet), sheet, follow_links=True)
        return DisplaySettings(dict(protocol.report.display), protocol.groups.main)
    return DisplaySettings()


def verdict(
    name: str, summary: Mapping[str, Any], others: Values, settings: DisplaySettings
) -> list[str]:
    """Write the verdict on a processed test.

    Parameters
    ----------
    name : of the test
    summary : from its summary.json
    others : ok values of each result in the other tests of its group
    settings : for display

    Returns
    -------
    Three lines: status; main numbers compared with the group; what to check.
    """
    results = summary["results"]
    main = _main_results(results, settings.main)
    numbers = [_number(result, others, settings.display) for result in main]
    outside = [number.name for number in numbers if number.is_outside]
    by_state = {
        state: [result["name"] for result in results if result["status"] == state]
        for state in ("failed", "doubtful")
    }
    n_ok = len(results) - sum(map(len, by_state.values()))
    parts = [f"{len(bad)} {state} ({_name_list(bad)})" for state, bad in by_state.items() if bad]
    parts += [f"outside the group: {_name_list(outside)}"] if outside else []
    head = f"{name}: {'LOOK' if parts else 'WELL'}, {', '.join([f'{n_ok} ok', *parts])}"
    comparisons = list(dict.fromkeys(number.against for number in numbers))
    if len(comparisons) == 1:  # common to all, and written once
        line = f"{'; '.join(number.text for number in numbers)}; {comparisons[0]}"
    else:
        line = "; ".join(f"{number.text}, {number.against}" for number in numbers) or "no numbers"
    codes = [reason["code"] for result in results for reason in result["reasons"]]
    codes += [note["code"] for note in summary.get("quality", []) if note["severity"] != "info"]
    return [head, f"  {line}", f"  {describe_actions(codes, outside=bool(outside))}"]


def describe_failure(name: str, code: str, reason: str) -> list[str]:
    """Write the verdict on a test that could not be processed.

    Parameters
    ----------
    name : of the test
    code, reason : of the failure

    Returns
    -------
    Three lines, as from `verdict`.
    """
    first = " ".join(reason.splitlines()[0].split()) if reason else code
    return [f"{name}: FAILED ({code})", f"  {first}", f"  {describe_actions([code])}"]


def describe_actions(codes: Iterable[str], *, outside: bool = False) -> str:
    """Write what to check while the specimen is mounted.

    Parameters
    ----------
    codes : of findings, most important first
    outside : whether a number is outside its group

    Returns
    -------
    One line.
    """
    max_actions = 3
    bench_actions = actions()
    chosen = list(dict.fromkeys(bench_actions[code] for code in codes if code in bench_actions))
    chosen += ["compare the set-up with that of the other tests before dismounting"] * outside
    if not chosen:
        return "nothing to check: the specimen can be dismounted"
    n_hidden = len(chosen) - max_actions
    more = f"; and {n_hidden} more in summary.json" if n_hidden > 0 else ""
    return f"while it is mounted: {'; '.join(chosen[:max_actions])}{more}"


@cache
def actions() -> dict[str, str]:
    """Read the actions at the bench by code."""
    text = (files("labpipe.campaign") / "bench_actions.toml").read_text(encoding="utf-8")
    return {code: load["do"] for load in tomllib.loads(text)["action"] for code in load["codes"]}


@dataclass(frozen=True, slots=True)
class _Number:
    """A formatted number, its comparison, and whether it is outside of the group."""

    name: str
    text: str
    against: str
    is_outside: bool = False


def _main_results(results: Sequence[_Entry], main: Sequence[str]) -> list[_Entry]:
    """Return the main results: those by which the protocol compares, else the first ones."""
    candidates = {
        result["name"]: result
        for result in results
        if not result["name"].startswith("clock_") and result.get("value") is not None
    }
    of_first_cycle = [name for name in candidates if not re.search(r"\.(?!1$)\d+$", name)]
    ranked = dict.fromkeys([*(name for name in main if name in candidates), *of_first_cycle])
    return [candidates[name] for name in ranked][:MAX_NUMBERS]


def _number(result: _Entry, others: Values, display: Mapping[str, str]) -> _Number:
    # Tests needed to judge what is outside the spread; with fewer, only the range is shown.
    min_group_tests = 6
    name, value = result["name"], float(result["value"])
    scale = shown_in(name, result["unit"], display)
    values = np.array(others.get(name, ()))
    text = f"{name} {scale.factor * value:.4g} {scale.unit}".rstrip()
    n = len(values)
    if n == 0:
        return _Number(name, text, "first of its group")
    if n < min_group_tests:
        low, high = sorted(scale.factor * np.array([values.min(), values.max()]))
        so_far = f"{low:.4g}" if n == 1 else f"{low:.4g} to {high:.4g}"
        return _Number(name, f"{text} (so far {so_far})", f"n = {n} so far, too few to judge")
    false_alarm_rate = 0.05  # of all numbers of a verdict together
    quantile = t_quantile(n - 1, false_alarm_rate / MAX_NUMBERS)
    reach = quantile * float(np.std(values, ddof=1)) * sqrt(1 + 1 / n)
    centre = float(values.mean())
    low, high = (scale.factor * (centre + side * reach) for side in (-1.0, 1.0))
    is_outside = abs(value - centre) > reach
    place = "OUTSIDE" if is_outside else "within"
    text += f" ({place} {low:.4g} to {high:.4g})"
    return _Number(name, text, f"n = {n} so far", is_outside)


def _name_list(names: Sequence[str]) -> str:
    max_names = 4
    more = f" and {len(names) - max_names} more" if len(names) > max_names else ""
    return ", ".join(names[:max_names]) + more
