"""Three lines on a test that was just made: well or not, its numbers, what to look at."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from math import sqrt
from pathlib import Path
from typing import Any, Final

import numpy as np

from labpipe.errors import LabpipeError
from labpipe.protocol.load import load_test_sheet, resolve
from labpipe.report.wording import shown_in
from labpipe.statistics.means import t_quantile

SHOWN: Final = 3
"""Numbers that a verdict shows."""
ENOUGH: Final = 6
"""Tests from which on a spread says what is outside; below, only the range is shown."""
_OUTSIDE: Final = 0.05
"""Chance that any of the numbers shown of a test like the others is called outside."""
_NAMED = 4
"""Results that are named as doubtful or failed."""
_ACTIONS = 3
"""Things to look at that are listed."""
_WITHOUT = ("spool", "sample", "uncertainty")
"""What tests of one group may differ in."""


@dataclass(slots=True)
class Group:
    """Values of the tests so far that are alike but for spool and sample, by result.

    Parameters
    ----------
    values : of each result those that are ok, by folder of the test
    """

    values: dict[str, dict[Path, float]] = field(default_factory=dict)

    def of(self, name: str, *, but: Path) -> list[float]:
        """Values of one result, without those of one test."""
        return [value for folder, value in self.values.get(name, {}).items() if folder != but]


class GroupsSoFar:
    """The numbers of the tests of a campaign, read once each from their ``summary.json``."""

    def __init__(self) -> None:
        self._groups: dict[str, Group] = {}
        self._seen: dict[Path, tuple[str, str]] = {}

    def group_of(self, summary: Mapping[str, Any]) -> Group:
        """Find the tests that are like another.

        Parameters
        ----------
        summary : of the other, as its summary.json says
        """
        return self._groups.setdefault(_key(summary), Group())

    def read(self, results: Mapping[Path, str]) -> None:
        """Read what is new or changed, and forget what is not there any more.

        Parameters
        ----------
        results : key of the results of each test that counts, by their folder
        """
        for folder in self._seen.keys() - results.keys():
            self._forget(folder)
        for folder, run in results.items():
            if run and self._seen.get(folder, ("", ""))[0] != run:
                self._forget(folder)
                self._read(folder, run)

    def _read(self, folder: Path, run: str) -> None:
        summary = read_summary(folder)
        if summary is None:
            return
        key = _key(summary)
        self._seen[folder] = (run, key)
        group = self._groups.setdefault(key, Group())
        for each in summary["results"]:
            if each.get("status") == "ok" and isinstance(each.get("value"), float | int):
                group.values.setdefault(each["name"], {})[folder] = float(each["value"])

    def _forget(self, folder: Path) -> None:
        _, key = self._seen.pop(folder, ("", ""))
        for values in self._groups.get(key, Group()).values.values():
            values.pop(folder, None)


def read_summary(folder: Path) -> dict[str, Any] | None:
    """Read the summary of a processed test.

    Parameters
    ----------
    folder : of its results

    Returns
    -------
    As it is written; None where there is none that can be read.
    """
    with suppress(OSError, ValueError):
        said = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        return said if isinstance(said, dict) and isinstance(said.get("results"), list) else None
    return None


def _key(summary: Mapping[str, Any]) -> str:
    specimen = summary.get("specimen")
    said = dict(specimen) if isinstance(specimen, Mapping) else {}
    kept = {key: value for key, value in said.items() if key not in _WITHOUT}
    return json.dumps([summary.get("protocol"), kept], sort_keys=True)


@dataclass(frozen=True, slots=True)
class Shown:
    """How numbers of a test are shown.

    Parameters
    ----------
    display : unit by quantity
    main : results that the protocol compares groups by, most wanted first
    """

    display: Mapping[str, str] = field(default_factory=dict)
    main: tuple[str, ...] = ()


def shown_by(sheet: Path) -> Shown:
    """Read from the protocol of a test how its numbers are shown.

    Parameters
    ----------
    sheet : its test.yaml; where it cannot be read, numbers are shown in SI
    """
    with suppress(LabpipeError, OSError):
        protocol = resolve(load_test_sheet(sheet), sheet, follow_links=True)
        return Shown(dict(protocol.report.display), protocol.groups.main)
    return Shown()


def verdict(
    name: str, folder: Path, summary: Mapping[str, Any], group: Group, shown: Shown
) -> list[str]:
    """Word the verdict on a processed test.

    Parameters
    ----------
    name : of the test
    folder : of its results
    summary : as its summary.json says
    group : the tests like it so far
    shown : how its numbers are shown

    Returns
    -------
    Three lines: well or not and which numbers; first numbers against the group; what to look at.
    """
    results = summary["results"]
    numbers = [_number(each, group, folder, shown) for each in _first(results, shown)]
    outside = [number.name for number in numbers if number.is_outside]
    states = {state: _of(results, state) for state in ("failed", "doubtful")}
    n_ok = len(results) - sum(map(len, states.values()))
    parts = [f"{len(names)} {state} ({_named(names)})" for state, names in states.items() if names]
    is_well = not parts and not outside
    parts += [f"outside the group: {_named(outside)}"] if outside else []
    head = f"{name}: {'WELL' if is_well else 'LOOK'}, {', '.join([f'{n_ok} ok', *parts])}"
    codes = [reason["code"] for result in results for reason in _reasons(result)]
    codes += [note["code"] for note in summary.get("quality", []) if note["severity"] != "info"]
    what = actions_for(codes, outside=bool(outside))
    return [head, f"  {_line(numbers)}", f"  {what}"]


def _line(numbers: Sequence[_Number]) -> str:
    """The numbers, and what they are compared with; once, where that is the same for all."""
    behind = list(dict.fromkeys(number.against for number in numbers))
    if len(behind) == 1:
        return f"{'; '.join(number.text for number in numbers)}; {behind[0]}"
    return "; ".join(f"{number.text}, {number.against}" for number in numbers) or "no numbers"


def refused(name: str, code: str, reason: str) -> list[str]:
    """Word the verdict on a test that could not be processed.

    Parameters
    ----------
    name : of the test
    code, reason : why

    Returns
    -------
    Three lines, as `verdict` gives them.
    """
    first = " ".join(reason.splitlines()[0].split()) if reason else code
    return [f"{name}: FAILED ({code})", f"  {first}", f"  {actions_for([code])}"]


def actions_for(codes: Iterable[str], *, outside: bool = False) -> str:
    """Say what to look at while the specimen is mounted.

    Parameters
    ----------
    codes : of what was found, most important first
    outside : whether a number is outside its group

    Returns
    -------
    One line.
    """
    known = actions()
    found = list(dict.fromkeys(known[code] for code in codes if code in known))
    found += ["compare the set-up with that of the other tests before you dismount"] * outside
    if not found:
        return "nothing to look at: the specimen can come off"
    more = f"; and {len(found) - _ACTIONS} more in summary.json" if len(found) > _ACTIONS else ""
    return f"while it is mounted: {'; '.join(found[:_ACTIONS])}{more}"


@cache
def actions() -> dict[str, str]:
    """Read what to do at the bench, by code."""
    text = (files("labpipe.campaign") / "bench_actions.toml").read_text(encoding="utf-8")
    return {code: load["do"] for load in tomllib.loads(text)["action"] for code in load["codes"]}


@dataclass(frozen=True, slots=True)
class _Number:
    """A number as it is shown, what it is compared with, and whether it is outside of that."""

    name: str
    text: str
    against: str
    is_outside: bool = False


def _first(results: Sequence[Mapping[str, Any]], shown: Shown) -> list[Mapping[str, Any]]:
    """The numbers that say most: those that the protocol compares by, else the first ones."""
    own = [result for result in results if not result["name"].startswith("clock_")]
    later = [each for each in own if each["name"].rpartition(".")[2].isdecimal()]
    repeats = [each for each in later if not each["name"].endswith(".1")]
    ranked = [each for name in shown.main for each in own if each["name"] == name]
    ranked += [each for each in own if each not in ranked and each not in repeats]
    known = [each for each in ranked if each.get("value") is not None]
    return known[:SHOWN]


def _number(each: Mapping[str, Any], group: Group, folder: Path, shown: Shown) -> _Number:
    scale = shown_in(each["name"], each["unit"], shown.display)
    others = np.array(group.of(each["name"], but=folder))
    value = float(each["value"])
    text = f"{each['name']} {scale.factor * value:.4g} {scale.unit}".rstrip()
    n = len(others)
    if n == 0:
        return _Number(each["name"], text, "the first of its group")
    if n < ENOUGH:
        low, high = sorted(scale.factor * np.array([others.min(), others.max()]))
        so_far = f"{low:.4g}" if n == 1 else f"{low:.4g} to {high:.4g}"
        against = f"n = {n} so far, too few to judge"
        return _Number(each["name"], f"{text} (so far {so_far})", against)
    reach = t_quantile(n - 1, _OUTSIDE / SHOWN) * float(np.std(others, ddof=1)) * sqrt(1 + 1 / n)
    centre = float(others.mean())
    low, high = (scale.factor * (centre + side * reach) for side in (-1.0, 1.0))
    is_outside = abs(value - centre) > reach
    place = "OUTSIDE" if is_outside else "within"
    shown_as = f"{text} ({place} {low:.4g} to {high:.4g})"
    return _Number(each["name"], shown_as, f"n = {n} so far", is_outside)


def _of(results: Iterable[Mapping[str, Any]], state: str) -> list[str]:
    return [result["name"] for result in results if result["status"] == state]


def _named(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more


def _reasons(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    said = result.get("reasons")
    return said if isinstance(said, list) else []
