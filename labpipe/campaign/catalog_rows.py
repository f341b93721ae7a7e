"""Rows of the catalog, and their reading from ``summary.json`` and ``failure.json`` of a test."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final

from labpipe.campaign.campaign_folders import OutcomeFiles
from labpipe.errors import StoreError
from labpipe.process.output_paths import RESULT_FILE
from labpipe.process.run import SUMMARY_FILE
from labpipe.store.summaries import FAILURE_FILE, SUMMARY_SCHEMA, compute_entry_seal

PENDING, RUNNING, OK, DOUBTFUL, FAILED, STALE, REJECTED = STATES = (
    *("pending", "running", "ok", "doubtful", "failed", "stale", "rejected"),
)
NEWER_RESULT: Final = "newer_result"
"""Code of a test whose results are from a newer labpipe and are not changed."""
Inputs = tuple[tuple[str, str, str], ...]
"""Role, file and SHA-256 of the exports of a test."""


@dataclass(frozen=True, slots=True)
class TestRow:
    """A row of the table ``tests``.

    Parameters
    ----------
    folder : of the test below the campaign, with slashes; the key
    test : its name
    state : one of `STATES` except ``running``
    why : what changed for a stale test, the reason for a rejected one, the fault of summary.json
        for a pending one
    code, reason : of a failure, or of the first result that is not ok
    protocol, type, spool, sample, date, operator : from summary.json, else the test sheet
    specimen : from summary.json, as JSON
    labpipe : version that made the last attempt
    run : key of the results; empty without results
    failed_run : key of the last attempt if it failed; empty if the failure has no key
    sheet, resolved : SHA-256 of test sheet and resolved protocol of the last attempt
    decided_by, decided : person and time of a rejection
    """

    __test__ = False  # pytest must not collect it

    folder: str
    test: str = ""
    state: str = PENDING
    why: str = ""
    code: str = ""
    reason: str = ""
    protocol: str = ""
    type: str = ""
    spool: str = ""
    sample: str = ""
    date: str = ""
    operator: str = ""
    specimen: str = "{}"
    labpipe: str = ""
    run: str = ""
    failed_run: str = ""
    sheet: str = ""
    resolved: str = ""
    decided_by: str = ""
    decided: str = ""

    @property
    def attempt(self) -> str:
        """Return the key of the last attempt; empty without any."""
        return self.failed_run or self.run


@dataclass(frozen=True, slots=True)
class ResultRow:
    """A result in the catalog; numbers are SI, None if not available.

    Parameters
    ----------
    name, value, unit, lower, upper, level, estimate, status : as in summary.json
    code, reason : codes and messages if doubtful or failed; else empty
    seal : SHA-256 of its numbers; empty if summary.json has none
    """

    name: str
    value: float | None
    unit: str
    lower: float | None
    upper: float | None
    level: float | None
    estimate: float | None
    status: str
    code: str
    reason: str
    seal: str = ""


TEST_COLUMNS: Final = tuple(field.name for field in fields(TestRow))
RESULT_COLUMNS: Final = tuple(field.name for field in fields(ResultRow))


@dataclass(frozen=True, slots=True)
class FileState:
    """State of the files of a test when its row was made.

    Parameters
    ----------
    content : inputs of the test, from `HashedInputs.to_json`; empty if not determined
    outcome : `OutcomeFiles.signature`, followed by ``without test.yaml`` for a test
        without a sheet
    """

    content: str = ""
    outcome: str = ""


@dataclass(frozen=True, slots=True)
class Entry:
    """Catalog entry of a test.

    Parameters
    ----------
    row : of the table ``tests``
    file_state : state of its files
    inputs : exports of the last attempt
    results : of the last successful attempt
    is_row_unchanged : whether only `file_state` is written, since the rest is still valid
    """

    row: TestRow
    file_state: FileState = FileState()
    inputs: Inputs = ()
    results: tuple[ResultRow, ...] = ()
    is_row_unchanged: bool = False


def encodable(value: object) -> str:
    """Convert to text that any file and database accepts; lone surrogates are escaped.

    Parameters
    ----------
    value : text, or anything else
    """
    return str(value).encode("utf-8", "backslashreplace").decode()


def as_json(content: Mapping[str, Any]) -> str:
    """Write an object as JSON with sorted keys, so that equal objects have equal text.

    Parameters
    ----------
    content : the object
    """
    return json.dumps(content, ensure_ascii=False, sort_keys=True)


def read_outcome(folder: str, files: OutcomeFiles | None) -> Entry:
    """Read the outcome of a test.

    Parameters
    ----------
    folder : of the test below the campaign
    files : of the outcome; None for none

    Returns
    -------
    Its entry: ``ok``, ``doubtful`` or ``failed``; ``pending`` without an outcome, or with one that
    cannot be read. A failure with the key of the results is ignored: a process that wrote these
    results was killed before it deleted the failure.
    """
    entry = Entry(TestRow(folder))
    if files is None:
        return entry
    if files.has_results:
        entry = _read_summary(folder, files.folder / SUMMARY_FILE)
    elif f"{SUMMARY_FILE}:" in files.signature:
        entry = Entry(TestRow(folder, why=f"{RESULT_FILE} is missing"))
    failure = _read_object(files.folder / FAILURE_FILE) or {} if files.has_failure else {}
    run = encodable(failure.get("run") or "")
    if not files.has_failure or (run and run == entry.row.run):
        return entry
    row = replace(
        entry.row,
        failed_run=run,
        state=FAILED,
        code=encodable(failure.get("code") or "unknown"),
        reason=encodable(failure.get("reason") or ""),
        labpipe=encodable(failure.get("labpipe") or entry.row.labpipe),
    )
    try:
        inputs = _parse_inputs(failure.get("inputs") or [])
        return replace(entry, row=replace(row, **_parse_hashes(failure)), inputs=inputs)
    except (KeyError, TypeError, AttributeError):
        return replace(entry, row=row)


def _read_summary(folder: str, path: Path) -> Entry:
    content = _read_object(path)
    if content is None:
        return Entry(TestRow(folder, why=f"{SUMMARY_FILE} cannot be read"))
    schema = content.get("schema")
    if isinstance(schema, int) and schema > SUMMARY_SCHEMA:
        newer = StoreError.about(
            "campaign.newer_summary", path, "schema", known=SUMMARY_SCHEMA, found=schema
        )
        return Entry(TestRow(folder, state=FAILED, code=NEWER_RESULT, reason=str(newer)))
    try:
        return _parse_summary(folder, content)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        return Entry(TestRow(folder, why=f"{SUMMARY_FILE} is damaged ({error})"))


def _parse_summary(folder: str, content: Mapping[str, Any]) -> Entry:
    results = tuple(map(_parse_result, content["results"]))
    doubtful = next((result for result in results if result.status != OK), None)
    specimen = {"type": "", "spool": "", "sample": "", **content["specimen"]}
    texts = {key: content[key] for key in ("test", "protocol", "labpipe", "run")}
    texts |= {key: content.get(key) or "" for key in ("date", "operator")}
    texts |= {key: specimen[key] for key in ("type", "spool", "sample")}
    row = TestRow(
        folder,
        state=PENDING if not content["run"] else OK if doubtful is None else DOUBTFUL,
        code="" if doubtful is None else doubtful.code,
        reason="" if doubtful is None else f"{doubtful.name}: {doubtful.reason}",
        specimen=encodable(as_json(specimen)),
        **{key: encodable(text) for key, text in texts.items()},
        **_parse_hashes(content),
    )
    return Entry(row, inputs=_parse_inputs(content["inputs"]), results=results)


def _parse_hashes(content: Mapping[str, Any]) -> dict[str, str]:
    """Return the SHA-256 of test sheet and resolved protocol."""
    made_of = content.get("made_of") or {}
    return {
        "sheet": encodable(made_of.get("sheet", "")),
        "resolved": encodable(made_of.get("protocol", "")),
    }


def _parse_inputs(entries: Iterable[Mapping[str, Any]]) -> Inputs:
    return tuple(
        (encodable(entry["role"]), encodable(entry["file"]), encodable(entry["sha256"]))
        for entry in entries
    )


def _parse_result(entry: Mapping[str, Any]) -> ResultRow:
    seal = encodable(entry.get("seal") or "")
    if seal and seal != compute_entry_seal(entry):
        message = f"the numbers of {entry['name']} were changed"
        raise ValueError(message)
    numbers = ("value", "lower", "upper", "level", "estimate")
    reasons = entry["reasons"]
    fields: dict[str, Any] = {name: encodable(entry[name]) for name in ("name", "unit", "status")}
    fields |= {name: None if entry[name] is None else float(str(entry[name])) for name in numbers}
    return ResultRow(
        **fields,
        code=encodable(", ".join(str(reason["code"]) for reason in reasons)),
        reason=encodable("; ".join(str(reason["message"]) for reason in reasons)),
        seal=seal,
    )


def _read_object(path: Path) -> dict[str, Any] | None:
    """Read the object of a JSON file; return None if the file has none."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None
