"""Collect the results of many processed tests in tables of tests and of groups."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pandas as pd

from labpipe.errors import (
    LabpipeError,
    StoreError,
    UsageError,
    describe_system_error,
    sort_by_likeness,
)
from labpipe.process.output_paths import RESULT_FILE, find_results, list_files_below
from labpipe.store.replace import is_unfinished
from labpipe.store.summaries import SUMMARY_FILE, read_summary

if TYPE_CHECKING:
    from labpipe.records.group import Group, GroupNumber

PathLike: TypeAlias = str | os.PathLike[str]
"""Path of a file or a folder."""
Paths: TypeAlias = PathLike | Iterable[PathLike]
"""One path or several."""


def parse_path(location: PathLike) -> Path:
    """Convert a location to a path that the system accepts; it need not exist.

    Parameters
    ----------
    location : path of a file or a folder

    Raises
    ------
    UsageError
        If the system refuses the path, for example because it is too long, contains a zero byte, or
        is in a folder without access.
    """
    path = Path(location)
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return path  # the caller reports missing files
    except OSError as error:
        raise UsageError(describe_system_error(error)) from error
    except ValueError as error:
        raise UsageError.about("api.no_path", repr(os.fspath(location)), found=error) from error
    return path


def parse_paths(locations: Paths) -> list[Path]:
    """Convert one location or several to paths.

    Parameters
    ----------
    locations : path of a file or a folder, or a list of paths

    Raises
    ------
    UsageError
        If the list is empty, or the system refuses a path.
    """
    location_list = [locations] if isinstance(locations, str | os.PathLike) else list(locations)
    if not location_list:
        raise UsageError.about("api.no_folders", "folder")
    return [parse_path(location) for location in location_list]


def parse_fields(by: str | Sequence[str]) -> tuple[str, ...]:
    """Convert the name of one field, or of several, to a tuple."""
    return (by,) if isinstance(by, str) else tuple(by)


_VALUE_COLUMNS = ("value", "estimate", "lower", "upper")
_TEXT_COLUMNS = ("unit", "status", "code", "reason")
_TEST_COLUMNS = ("protocol", "date", "operator", "folder")


class LeftOutWarning(UserWarning):
    """Some tests are left out of a table because they cannot be read."""


def table(folder: Paths, *, by: str | Sequence[str] = ()) -> pd.DataFrame:
    """Put the results of processed tests into one table.

    Parameters
    ----------
    folder : folder with processed tests at any depth, or several such folders
    by : field or fields of the test sheets, which become the first columns and sort the rows

    Returns
    -------
    Table with a row for each result of each test. Its columns are ``test``; the fields of the
    sheets (``type``, ``spool``, ``sample``, dimensions in m as float64, texts of a bundle, labels,
    observations; a label with the name of another column is ``label_<name>``); ``protocol``,
    ``date`` (datetime64), ``operator``, ``folder``; ``result`` (name of the result), ``value``,
    ``estimate``, ``lower``, ``upper`` (SI, float64, NaN if not available), ``unit``, ``status``,
    ``code``, ``reason``. Missing fields are NaN. ``attrs["left_out"]`` has the reason for each test
    that is left out, keyed by folder.

    Raises
    ------
    UsageError
        If there is no processed test, or no sheet has a field of `by`.
    StoreError
        If no summary can be read.

    Warns
    -----
    LeftOutWarning
        If some summaries cannot be read.

    Examples
    --------
    >>> labpipe.table("processed/A2", by=["type", "length"])  # doctest: +SKIP
    """
    by = parse_fields(by)
    rows, left_out = _read_summaries(_find_summaries(parse_paths(folder)))
    fields = dict.fromkeys(name for test, _ in rows for name in test if name not in _TEST_COLUMNS)
    sheet_fields = [name for name in fields if name != "test"]
    for name in by:
        if name not in sheet_fields:
            valid = ", ".join(sort_by_likeness(name, sheet_fields))
            raise UsageError.about("api.no_field", "by", fields=valid, found=name)
    order = dict.fromkeys(("test", *by, *fields, *_TEST_COLUMNS))
    columns = {name: [test.get(name) for test, _ in rows] for name in order}
    counts = [len(results) for _, results in rows]
    frame = pd.DataFrame({name: _make_column(name, values) for name, values in columns.items()})
    frame = frame.loc[np.repeat(np.arange(len(rows)), counts)].reset_index(drop=True)
    all_results = [result for _, results in rows for result in results]
    for name in ("result", *_VALUE_COLUMNS, *_TEXT_COLUMNS):
        dtype = "float64" if name in _VALUE_COLUMNS else "str"
        frame[name] = pd.Series([result[name] for result in all_results], dtype=dtype)
    if by:
        frame = frame.sort_values(list(by), kind="stable", ignore_index=True)
    frame.attrs["left_out"] = left_out
    return frame


def _find_summaries(folders: Sequence[Path]) -> list[Path]:
    """Find the summaries of processed tests, which are beside result files."""
    summaries: dict[Path, None] = {}
    for folder in folders:
        files = list_files_below(folder, SUMMARY_FILE) if folder.is_dir() else []
        files = [file for file in files if (file.parent / RESULT_FILE).exists()]
        if not files:
            found = "none" if folder.is_dir() else "a file" if folder.exists() else "nothing there"
            raise UsageError.about("api.no_tests", folder, found=found)
        summaries |= dict.fromkeys(files)
    return list(summaries)


_Row: TypeAlias = tuple[dict[str, Any], list[dict[str, Any]]]
"""Fields of a test, and columns of each of its results."""


def _read_summaries(files: Iterable[Path]) -> tuple[list[_Row], dict[str, str]]:
    """Read summaries, and the reasons why some cannot be read, keyed by folder."""
    rows: list[_Row] = []
    left_out: dict[str, str] = {}
    for file in files:
        try:
            rows.append(_read_row(file))
        except LabpipeError as error:
            left_out[str(file.parent)] = str(error)
    if not rows:
        raise StoreError("\n".join(left_out.values()))
    if left_out:
        warnings.warn("\n".join(left_out.values()), LeftOutWarning, stacklevel=3)
    return rows, left_out


def _read_row(file: Path) -> _Row:
    """Read the fields and the results of a test from its summary."""
    if is_unfinished(file.parent):
        raise StoreError.about("api.cut_off", file, folder=file.parent)
    content = read_summary(file)
    try:
        day = content.get("date")
        test = {
            "test": str(content["test"]),
            **_list_fields(content["specimen"]),
            "protocol": str(content["protocol"]),
            "date": date.fromisoformat(day) if day else None,
            "operator": str(content.get("operator") or ""),
            "folder": str(file.parent),
        }
        return test, [_parse_result(entry) for entry in content["results"]]
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        raise StoreError.about("api.damaged_summary", file, found=error) from error


def _list_fields(specimen: Mapping[str, Any]) -> dict[str, Any]:
    """List the fields of a test sheet, keyed by column, without the list of wires of a bundle."""
    simple_fields = {name: value for name, value in specimen.items() if not isinstance(value, dict)}
    bundle = dict(specimen.get("bundle", {}))
    bundle_fields = {name: value for name, value in bundle.items() if not isinstance(value, list)}
    other_columns = ("test", "result", *_TEST_COLUMNS, *_VALUE_COLUMNS, *_TEXT_COLUMNS)
    reserved_names = {*simple_fields, *bundle_fields, *other_columns}
    labels = {
        f"label_{name}" if name in reserved_names else str(name): str(text)
        for key in ("labels", "observed")
        for name, text in dict(specimen.get(key, {})).items()
    }
    return simple_fields | bundle_fields | labels


def _parse_result(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Convert a result of a summary to the columns of a row."""
    values = [np.nan if entry[name] is None else float(entry[name]) for name in _VALUE_COLUMNS]
    texts = {name: str(entry[name]) for name in _TEXT_COLUMNS}
    return {"result": str(entry["name"]), **dict(zip(_VALUE_COLUMNS, values, strict=True)), **texts}


def _make_column(name: str, values: Sequence[Any]) -> pd.Series:
    """Make a column of dates, of numbers if all values are numbers, or of texts."""
    if name == "date":
        return pd.Series(pd.to_datetime(pd.Series(values, dtype="object")))
    present = [value for value in values if value is not None]
    is_number = bool(present) and all(isinstance(value, int | float) for value in present)
    return pd.Series(values, dtype="float64" if is_number else "str")


def groups(
    folder: Paths, *, by: str | Sequence[str] = (), say: Callable[[str], None] = lambda _: None
) -> pd.DataFrame:
    """Group processed tests as ``labpipe report`` does, with means and intervals.

    Parameters
    ----------
    folder : folder with processed tests at any depth, or several such folders
    by : field or fields whose values make the groups; if empty, those of a report
    say : function that is called with the name of each test when the test is read

    Returns
    -------
    Table with a row for each result of each group. Its columns are ``group``, ``protocol``,
    ``result``, ``mean``, ``estimate`` (mean without the contribution of noise), ``lower``,
    ``upper`` (95 % interval of the estimate), ``deviation`` (standard deviation of the averaged
    values; all in SI, float64), ``n`` (number of averaged values: samples, or means of spools),
    ``tests`` (number of tests with the result), ``unit``, ``how`` (which values are averaged, and
    why), ``reason`` (why there is no interval; otherwise empty). ``attrs["left_out"]`` has the
    reason for each test that is left out, keyed by file.

    Raises
    ------
    LabpipeError
        If there is no processed test, none can be read, two have the same name, or no test sheet
        has a field of `by`.
    """
    # This import takes half a second.
    from labpipe.campaign.reporting import ReportOptions, make_campaign, read_tests

    tests = read_tests(find_results(parse_paths(folder)), say)
    campaign = make_campaign(tests, "", ReportOptions(by=parse_fields(by)))
    rows = [_make_group_row(group, x) for group in campaign.groups for x in group.numbers]
    frame = pd.DataFrame(rows, columns=list(_GROUP_TYPES)).astype(_GROUP_TYPES)
    frame.attrs["left_out"] = dict(campaign.left_out)
    return frame


_GROUP_TYPES = {
    **dict.fromkeys(("group", "protocol", "result"), "str"),
    **dict.fromkeys(("mean", "estimate", "lower", "upper", "deviation"), "float64"),
    **dict.fromkeys(("n", "tests"), "int64"),
    **dict.fromkeys(("unit", "how", "reason"), "str"),
}


def _make_group_row(group: Group, result: GroupNumber) -> dict[str, Any]:
    """Make the row of one result of a group."""
    row: dict[str, Any] = {
        "group": group.name,
        "protocol": group.protocol,
        "result": result.name,
        "tests": len(result.values),
        "unit": result.unit,
        "n": 0,
        "how": "",
        "reason": "no test has this result",
    }
    if not result.values:
        return row
    mean = result.mean.chosen
    interval = mean.interval
    return row | {
        "mean": mean.mean,
        "estimate": mean.mean if mean.estimate is None else mean.estimate,
        "lower": np.nan if interval is None else interval.lower,
        "upper": np.nan if interval is None else interval.upper,
        "deviation": mean.deviation,
        "n": mean.n,
        "how": str(result.mean.decision),
        "reason": "" if mean.reason is None else str(mean.reason),
    }
