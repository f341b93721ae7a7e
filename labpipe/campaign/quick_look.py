"""Judge a newly processed test: status, comparison with its group, and what to check."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from math import sqrt
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from labpipe.campaign.catalog_rows import TestRow
from labpipe.records.quality import Severity
from labpipe.records.result import Result, Status, TestResult
from labpipe.report.wording import find_display_unit
from labpipe.statistics.means import compute_t_quantile

MAX_NUMBERS: Final = 3
"""Largest number of results in a verdict."""

Values: TypeAlias = Mapping[str, Sequence[float]]
"""Values of several tests by result."""


def make_group_key(row: TestRow) -> str:
    """Make the key of the group of a test from its protocol and specimen without spool and sample.

    Parameters
    ----------
    row : of the test
    """
    ignored_fields = ("spool", "sample", "uncertainty")  # these may differ within a group
    specimen = json.loads(row.specimen)
    fields = {key: value for key, value in specimen.items() if key not in ignored_fields}
    return json.dumps([row.protocol, fields], sort_keys=True)


def describe_test(
    name: str, test: TestResult, group_values: Values, main: Sequence[str]
) -> list[str]:
    """Describe a processed test for the person at the bench.

    Parameters
    ----------
    name : of the test
    test : its results
    group_values : values of each result in the other tests of its group, if ok
    main : names of the main results, by which the protocol compares groups, in order

    Returns
    -------
    Three lines: status, comparison of the main results with the group, and what to check.
    """
    numbers = [
        _compare_with_group(result, group_values, test.display)
        for result in _select_main_results(test.results, main)
    ]
    outside = [number.name for number in numbers if number.is_outside]
    names = {
        status: [result.name for result in test.results if result.status is status]
        for status in (Status.FAILED, Status.DOUBTFUL)
    }
    n_ok = len(test.results) - sum(map(len, names.values()))
    parts = [f"{len(bad)} {status} ({_join_names(bad)})" for status, bad in names.items() if bad]
    parts += [f"outside the group: {_join_names(outside)}"] if outside else []
    headline = f"{name}: {'CHECK' if parts else 'OK'}, {', '.join([f'{n_ok} ok', *parts])}"
    group_sizes = list(dict.fromkeys(number.group_size for number in numbers))
    if len(group_sizes) == 1:  # written once for all
        texts = [*(number.text for number in numbers), *group_sizes]
    else:
        texts = [f"{number.text}, {number.group_size}" for number in numbers] or ["no numbers"]
    codes = [code for result in test.results for code in result.codes]
    codes += [note.code for note in test.quality if note.severity is not Severity.INFO]
    actions = describe_actions(codes, outside=bool(outside))
    return [headline, f"  {'; '.join(texts)}", f"  {actions}"]


def describe_failure(name: str, code: str, reason: str) -> list[str]:
    """Describe a test that could not be processed.

    Parameters
    ----------
    name : of the test
    code, reason : of the failure

    Returns
    -------
    Three lines, as of `describe_test`.
    """
    first_line = " ".join(reason.splitlines()[0].split()) if reason else code
    return [f"{name}: FAILED ({code})", f"  {first_line}", f"  {describe_actions([code])}"]


def describe_actions(codes: Iterable[str], *, outside: bool = False) -> str:
    """Describe what to check while the specimen is mounted.

    Parameters
    ----------
    codes : of notes, reasons and failures, most important first
    outside : whether a result is outside the prediction interval of its group

    Returns
    -------
    One line.
    """
    max_actions = 3
    bench_actions = read_actions()
    chosen = list(dict.fromkeys(bench_actions[code] for code in codes if code in bench_actions))
    chosen += ["compare the set-up with that of the other tests before dismounting"] * outside
    if not chosen:
        return "nothing to check: the specimen can be dismounted"
    n_hidden = len(chosen) - max_actions
    more = f"; and {n_hidden} more in summary.json" if n_hidden > 0 else ""
    return f"while it is mounted: {'; '.join(chosen[:max_actions])}{more}"


@cache
def read_actions() -> dict[str, str]:
    """Read the checks at the bench by code of a note, reason or failure."""
    text = (files("labpipe.campaign") / "bench_actions.toml").read_text(encoding="utf-8")
    entries = tomllib.loads(text)["action"]
    return {code: entry["do"] for entry in entries for code in entry["codes"]}


class _Comparison(NamedTuple):
    """A result as text, the size of its group, and whether it is outside that group."""

    name: str
    text: str
    group_size: str
    is_outside: bool = False


def _select_main_results(results: Sequence[Result], main: Sequence[str]) -> list[Result]:
    """Select main results of the protocol first, then results of the first cycle."""
    candidates = {
        result.name: result
        for result in results
        if not result.name.startswith("clock_") and result.value is not None
    }
    of_first_cycle = [name for name in candidates if not re.search(r"\.(?!1$)\d+$", name)]
    ranked = dict.fromkeys([*(name for name in main if name in candidates), *of_first_cycle])
    return [candidates[name] for name in ranked][:MAX_NUMBERS]


def _compare_with_group(
    result: Result, group_values: Values, display: Mapping[str, str]
) -> _Comparison:
    """Compare a result with the other tests of its group by a Student prediction interval."""
    min_group_tests = 6  # for a prediction interval; below, the range is shown
    name, value = result.name, result.value or 0.0
    factor, unit = find_display_unit(name, result.unit, display)
    values = factor * np.array(group_values.get(name, ()))
    n, text = len(values), f"{name} {factor * value:.4g} {unit}".rstrip()
    if n == 0:
        return _Comparison(name, text, "first of its group")
    if n < min_group_tests:
        low, high = sorted([values.min(), values.max()])
        range_text = f"{low:.4g}" if n == 1 else f"{low:.4g} to {high:.4g}"
        return _Comparison(
            name, f"{text} (so far {range_text})", f"n = {n} so far, too few to judge"
        )
    false_alarm_rate = 0.05  # per verdict, shared by its numbers
    quantile = compute_t_quantile(n - 1, false_alarm_rate / MAX_NUMBERS)
    half_width = quantile * float(np.std(values, ddof=1)) * sqrt(1 + 1 / n)
    low, high = values.mean() - half_width, values.mean() + half_width
    is_outside = not low <= factor * value <= high
    position = "OUTSIDE" if is_outside else "within"
    text += f" ({position} {low:.4g} to {high:.4g})"
    return _Comparison(name, text, f"n = {n} so far", is_outside)


def _join_names(names: Sequence[str]) -> str:
    max_names = 4
    more = f" and {len(names) - max_names} more" if len(names) > max_names else ""
    return ", ".join(names[:max_names]) + more
