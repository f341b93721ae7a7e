"""Write and read summaries of tests (summary.json), and write their failures (failure.json)."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from datetime import date
from hashlib import sha256
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from labpipe import __version__
from labpipe.errors import StoreError
from labpipe.records.result import InputFile, Result, Specimen, TestResult, compute_seal
from labpipe.statistics.lots import judge_results
from labpipe.store.replace import lock, replace_file

SUMMARY_FILE, FAILURE_FILE = "summary.json", "failure.json"
"""Names of the files with the summary and with the failure of a test."""
SUMMARY_SCHEMA, FAILURE_SCHEMA = 2, 1
"""Numbers of the schemas of these files."""


def build_summary(result: TestResult) -> dict[str, object]:
    """Build the summary of a test, with numbers in SI units.

    Parameters
    ----------
    result : processed test

    Returns
    -------
    The content of ``summary.json``. Numbers that are not finite or not available are None; status
    and reasons explain them.
    """
    verdict = judge_results(result.results)  # None if the protocol states no limit
    return {
        "schema": SUMMARY_SCHEMA,
        "test": result.test,
        "specimen": _build_specimen(result.specimen),
        "protocol": result.protocol,
        "labpipe": result.labpipe_version,
        "inputs": _build_inputs(result.inputs),
        "date": to_json(result.date),
        "operator": result.operator,
        "instruments": to_json(result.instruments),
        "run": result.run,
        "made_of": {
            "sheet": sha256(result.test_yaml.encode()).hexdigest(),
            "protocol": sha256(result.protocol_yaml.encode()).hexdigest(),
        },
        "results": [build_result_entry(entry) for entry in result.results],
        **({} if verdict is None else {"verdict": to_json(verdict)}),
        "quality": [select_json(note, "code", "severity", "message") for note in result.quality],
    }


def write_summary(result: TestResult, path: Path) -> None:
    """Write ``summary.json``, and keep an earlier file until the new one is complete.

    Parameters
    ----------
    result : processed test
    path : path of the summary

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    text = json.dumps(build_summary(result), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with replace_file(path) as temporary_file:
        temporary_file.write_bytes(text.encode())


def to_json(value: Any) -> Any:
    """Convert records, arrays and dates to types of JSON; numbers that are not finite become None.

    Parameters
    ----------
    value : record, mapping, sequence, array, number, text, date or None
    """
    if is_dataclass(value):
        return {field.name: to_json(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): to_json(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(entry) for entry in value]
    if isinstance(value, np.ndarray):
        is_plain = value.dtype.kind in "biuf" and bool(np.isfinite(value).all())
        return value.tolist() if is_plain else to_json(value.tolist())
    if isinstance(value, float):
        return replace_non_finite(value)
    return str(value) if isinstance(value, str | date) else value


def select_json(record: object, *names: str, **renamed_attributes: str) -> dict[str, Any]:
    """Convert some attributes of a record to types of JSON, as `to_json` does.

    Parameters
    ----------
    record : object with the attributes
    names : names of attributes, which are also the names of their entries
    renamed_attributes : names of attributes whose entries have other names, keyed by name of the
        entry
    """
    attributes = {name: name for name in names} | renamed_attributes
    return {entry: to_json(getattr(record, name)) for entry, name in attributes.items()}


def _build_specimen(specimen: Specimen) -> dict[str, object]:
    """Build the entry of a specimen, in which dimensions are on the level of the names."""
    content = to_json(specimen)
    bundle = specimen.bundle
    bundle_totals = {"composition": bundle.composition, "number": bundle.number} if bundle else {}
    extras = {"bundle": bundle_totals | (content["bundle"] or {}), "labels": content["labels"]}
    extras["observed"] = content["observed"]
    return {
        **{name: content[name] for name in ("type", "spool", "sample")},
        **content["dimensions"],
        **{name: entry for name, entry in extras.items() if entry},
    }


def build_result_entry(result: Result) -> dict[str, object]:
    """Build the entry of a result in ``summary.json``.

    Parameters
    ----------
    result : result of a test or of a harness
    """
    interval = result.interval
    shares = zip(result.budget, result.fractions, strict=True)
    entry: dict[str, object] = to_json({
        "name": result.name,
        "value": result.value,
        "unit": result.unit,
        "lower": interval and interval.lower,
        "upper": interval and interval.upper,
        "level": interval and interval.level,
        "estimate": result.best_estimate,
        "status": result.status,
        "seal": result.seal,
        "code": ", ".join(result.codes),
        "reason": result.reason_text,
        "reasons": result.reasons,
        "method": result.full_method,
        "budget": [
            {"cause": row.cause, "change": row.change, "share": share, "common": row.is_common}
            for row, share in shares
        ],
    })  # fmt: skip
    return entry


def _build_inputs(inputs: Iterable[InputFile]) -> list[dict[str, Any]]:
    """Build the entries of the exports of a test."""
    return [select_json(export, "role", "file", "sha256") for export in inputs]


def check_summary(result: TestResult, path: Path) -> None:
    """Raise an error if numbers of a ``summary.json`` differ from those of its result file.

    Parameters
    ----------
    result : test as read from its result file
    path : path of the summary; nothing is compared if it does not exist

    Raises
    ------
    StoreError
        If a result of the summary has another seal, or numbers that do not match its seal, or if
        the summary cannot be read or is damaged.
    """
    if not path.is_file():
        return
    seals = {entry.name: entry.seal for entry in result.results}
    try:
        for entry in read_summary(path)["results"]:
            if not entry["seal"] == compute_entry_seal(entry) == seals.get(entry["name"]):
                raise StoreError.about("store.other_numbers", path, str(entry["name"]))
    except (LookupError, TypeError) as error:
        raise StoreError.about("store.damaged_summary", path, reason=error) from error


def compute_entry_seal(entry: Mapping[str, Any]) -> str:
    """Compute the seal of the numbers of an entry of ``summary.json``.

    Parameters
    ----------
    entry : entry as `build_result_entry` makes it
    """
    numbers = [entry[key] for key in ("value", "lower", "upper", "level", "estimate")]
    return compute_seal(entry["name"], entry["unit"], entry["status"], numbers)


def replace_non_finite(value: float | None) -> float | None:
    """Replace NaN and infinities, which JSON does not have, by None."""
    return float(value) if value is not None and isfinite(value) else None


def read_summary(path: Path) -> dict[str, Any]:
    """Read a ``summary.json``.

    Parameters
    ----------
    path : path of the summary

    Returns
    -------
    The content of the file.

    Raises
    ------
    StoreError
        If the file cannot be read, is not a summary of labpipe, or is of another schema.
    """
    max_bytes = 1 << 26  # a hundred times the summary of a test with a hundred cycles
    try:
        is_readable = path.is_file() and path.stat().st_size <= max_bytes
        content = json.loads(path.read_bytes(), parse_int=_parse_integer) if is_readable else None
    except (OSError, ValueError, RecursionError) as error:
        raise StoreError.about("store.damaged_summary", path, reason=error) from error
    if not isinstance(content, dict) or not isinstance(schema := content.get("schema"), int):
        raise StoreError.about("store.no_summary", path)
    if schema != SUMMARY_SCHEMA:
        is_newer = schema > SUMMARY_SCHEMA
        raise StoreError.about(
            "store.newer_summary" if is_newer else "store.other_summary", path, schema=schema
        )
    return content


def _parse_integer(digits: str) -> float:
    """Parse an integer of JSON; one with more digits than a float can resolve is a float."""
    max_digits = 15
    return int(digits) if len(digits) <= max_digits else float(digits)


@dataclass(frozen=True, slots=True)
class FailedTest:
    """Test that could not be processed, with the reason.

    Parameters
    ----------
    test : name of the test; empty if unknown
    code : code of the reason, one of `labpipe.errors.CODES`
    reason : message for the user
    run : key of the inputs of the failed run; empty if unknown
    inputs : exports; empty if one of them cannot be read
    made_of : SHA-256 of the test sheet and of the resolved protocol, as in ``summary.json``; empty
        if they cannot be read
    """

    test: str
    code: str
    reason: str
    run: str = ""
    inputs: tuple[InputFile, ...] = ()
    made_of: Mapping[str, str] = field(default_factory=dict)


def write_failure(failure: FailedTest, folder: Path) -> None:
    """Write ``failure.json``, and leave other files in the folder unchanged.

    Parameters
    ----------
    failure : failure of the test
    folder : folder of the results of the test; created if it does not exist

    Raises
    ------
    StoreError
        If the file cannot be written, or another labpipe process works in the folder.
    """
    versions = {"schema": FAILURE_SCHEMA, "labpipe": __version__}
    content = versions | asdict(failure) | {"inputs": _build_inputs(failure.inputs)}
    text = json.dumps(content, indent=2, ensure_ascii=False)
    with lock(folder), replace_file(folder / FAILURE_FILE) as temporary_file:
        temporary_file.write_bytes(f"{text}\n".encode("utf-8", "backslashreplace"))
