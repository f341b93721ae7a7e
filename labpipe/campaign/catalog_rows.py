"""Read rows of the catalog from ``summary.json`` and ``failure.json`` of a test."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

from labpipe.campaign.campaign_folders import OutcomeFiles
from labpipe.errors import StoreError
from labpipe.process.output_paths import RESULT_FILE
from labpipe.store.summaries import (
    FAILURE_FILE,
    SUMMARY_FILE,
    SUMMARY_SCHEMA,
    compute_entry_seal,
)

PENDING, RUNNING, OK, DOUBTFUL, FAILED, STALE, REJECTED = STATES = (
    *("pending", "running", "ok", "doubtful", "failed", "stale", "rejected"),
)
NEWER_RESULT: Final = "newer_result"
"""Code of a test whose results were made by a newer labpipe and are not replaced."""
Inputs = tuple[tuple[str, str, str], ...]
"""Role, file and SHA-256 of the exports of a test."""


class TestRow(NamedTuple):
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
    def attempt_key(self) -> str:
        """Return the key of the last attempt; of the results if a failure has no key."""
        return self.failed_run or self.run

    @property
    def is_due(self) -> bool:
        """Return whether the test must be processed."""
        return self.state in {PENDING, STALE}


TestRow.__test__ = False  # type: ignore[attr-defined]  # pytest must not collect it
NUMBERS: Final = ("value", "lower", "upper", "level", "estimate")


class ResultRow(NamedTuple):
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


class FileState(NamedTuple):
    """State of the files of a test when its row was made.

    Parameters
    ----------
    inputs_json : inputs of the test, from `HashedInputs.to_json`; empty if not determined
    fingerprint : text that changes with outcome files, inputs and decisions of the test
    """

    inputs_json: str = ""
    fingerprint: str = ""


class Entry(NamedTuple):
    """Catalog entry of a test.

    Parameters
    ----------
    row : of the table ``tests``
    file_state : state of its files
    inputs : exports of the last attempt
    results : of the last successful attempt
    """

    row: TestRow
    file_state: FileState = FileState()
    inputs: Inputs = ()
    results: tuple[ResultRow, ...] = ()


def escape_surrogates(value: object) -> str:
    """Convert a value to text with lone surrogates escaped, so that files and databases accept it.

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
    files : outcome files of the test; None if it has none

    Returns
    -------
    Its entry: ``ok``, ``doubtful`` or ``failed``; ``pending`` without an outcome, or with one that
    cannot be read. A failure with the same key as the results is ignored: the process that wrote
    these results was killed before it deleted the older failure.
    """
    entry = Entry(TestRow(folder))
    if files is None:
        return entry
    if files.has_results:
        entry = _read_summary(folder, files.folder / SUMMARY_FILE)
    elif f"{SUMMARY_FILE}:" in files.signature:
        entry = Entry(TestRow(folder, why=f"{RESULT_FILE} is missing"))
    failure = _read_object(files.folder / FAILURE_FILE) or {} if files.has_failure else {}
    run = failure.get("run") or ""
    if not files.has_failure or (run and run == entry.row.run):
        return entry
    row = entry.row._replace(
        state=FAILED,
        failed_run=str(run),
        code=str(failure.get("code") or "unknown"),
        reason=str(failure.get("reason") or ""),
        labpipe=str(failure.get("labpipe") or entry.row.labpipe),
    )
    try:
        inputs = _parse_inputs(failure.get("inputs") or [])
        return entry._replace(row=row._replace(**_parse_hashes(failure)), inputs=inputs)
    except (KeyError, TypeError, AttributeError):
        return entry._replace(row=row)


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


_TEXTS_OF_SUMMARY = (
    *("test", "protocol", "labpipe", "run", "date", "operator"),
    *("type", "spool", "sample"),
)
"""Columns of a test that are copied from summary.json."""


def _parse_summary(folder: str, content: Mapping[str, Any]) -> Entry:
    results = tuple(map(_parse_result, content["results"]))
    doubtful = next((result for result in results if result.status != OK), None)
    specimen = {"type": "", "spool": "", "sample": "", **content["specimen"]}
    texts = {**specimen, **content}
    row = TestRow(
        folder,
        state=PENDING if not content["run"] else OK if doubtful is None else DOUBTFUL,
        code="" if doubtful is None else doubtful.code,
        reason="" if doubtful is None else f"{doubtful.name}: {doubtful.reason}",
        specimen=escape_surrogates(as_json(specimen)),
        **{key: str(texts.get(key) or "") for key in _TEXTS_OF_SUMMARY},
        **_parse_hashes(content),
    )
    return Entry(row, inputs=_parse_inputs(content["inputs"]), results=results)


def _parse_hashes(content: Mapping[str, Any]) -> dict[str, str]:
    """Return the SHA-256 of test sheet and resolved protocol."""
    made_of = content.get("made_of") or {}
    return {"sheet": str(made_of.get("sheet", "")), "resolved": str(made_of.get("protocol", ""))}


def _parse_inputs(entries: Iterable[Mapping[str, Any]]) -> Inputs:
    return tuple((str(file["role"]), str(file["file"]), str(file["sha256"])) for file in entries)


def _parse_result(entry: Mapping[str, Any]) -> ResultRow:
    seal = str(entry.get("seal") or "")
    if seal and seal != compute_entry_seal(entry):
        message = f"the numbers of {entry['name']} were changed"
        raise ValueError(message)
    fields: dict[str, Any] = {name: str(entry[name]) for name in ("name", "unit", "status")}
    fields |= {name: None if entry[name] is None else float(str(entry[name])) for name in NUMBERS}
    return ResultRow(
        **fields,
        code=", ".join(str(reason["code"]) for reason in entry["reasons"]),
        reason="; ".join(str(reason["message"]) for reason in entry["reasons"]),
        seal=seal,
    )


def _read_object(path: Path) -> dict[str, Any] | None:
    """Read the object of a JSON file, with lone surrogates escaped; None if there is none."""
    try:
        text = path.read_text(encoding="utf-8")
        content = json.loads(text, object_hook=_escape_texts if "\\u" in text else None)
    except (OSError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def _escape_texts(content: dict[str, Any]) -> dict[str, Any]:
    return {
        key: escape_surrogates(value) if isinstance(value, str) else value
        for key, value in content.items()
    }
