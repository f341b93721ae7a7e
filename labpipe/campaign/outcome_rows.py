"""Read the catalog rows of a test from its files summary.json and failure.json."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from labpipe.campaign.campaign_folders import OutcomeFiles
from labpipe.errors import error_text
from labpipe.process.output_paths import RESULT_FILE
from labpipe.process.run import SUMMARY_FILE
from labpipe.store.summaries import FAILURE_FILE, SUMMARY_SCHEMA, sealed

NEWER_RESULT: Final = "newer_result"
"""Code of a test whose results are from a newer labpipe; they are not changed."""
_SPECIMEN = ("type", "spool", "sample")


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


@dataclass(frozen=True, slots=True)
class StoredOutcome:
    """Outcome of a test from its files.

    Parameters
    ----------
    test, protocol, date, operator, labpipe : as in summary.json; empty if missing
    specimen : as in summary.json
    run : key of the results; empty without results
    failed_run : key of the last attempt if it failed; may be empty even then
    has_failed : whether the last attempt failed
    code, reason : of the failure, or of the first doubtful result; else empty
    sheet, protocol_text : SHA-256 of test sheet and resolved protocol; empty if not known
    inputs : role, file and SHA-256 of the exports
    results : of the last successful attempt
    unreadable : fault of summary.json; empty if it is valid or missing
    """

    test: str = ""
    protocol: str = ""
    date: str = ""
    operator: str = ""
    labpipe: str = ""
    specimen: Mapping[str, Any] = field(default_factory=dict)
    run: str = ""
    failed_run: str = ""
    has_failed: bool = False
    code: str = ""
    reason: str = ""
    sheet: str = ""
    protocol_text: str = ""
    inputs: tuple[tuple[str, str, str], ...] = ()
    results: tuple[ResultRow, ...] = ()
    unreadable: str = ""

    @property
    def attempt(self) -> str:
        """Return the key of the last attempt."""
        return self.failed_run if self.has_failed else self.run


def encodable(value: object) -> str:
    """Return text that any file and database accepts: lone surrogates are escaped.

    Parameters
    ----------
    value : text, or anything else
    """
    return str(value).encode("utf-8", "backslashreplace").decode()


def read_outcome_files(files: OutcomeFiles | None) -> StoredOutcome:
    """Read the outcome of a test.

    Parameters
    ----------
    files : of the outcome; None for none

    Returns
    -------
    The outcome. A failure with the key of the results is ignored: it is left over from a process
    that was killed before deleting it.
    """
    if files is None:
        return StoredOutcome()
    done = _read_summary(files.folder / SUMMARY_FILE) if files.has_results else StoredOutcome()
    if not files.has_results and f"{SUMMARY_FILE}:" in files.marks:
        done = StoredOutcome(unreadable=f"{RESULT_FILE} is missing")
    if not files.has_failure:
        return done
    return _with_failure(done, _read_object(files.folder / FAILURE_FILE) or {})


def _with_failure(done: StoredOutcome, failure: Mapping[str, Any]) -> StoredOutcome:
    run = encodable(failure.get("run") or "")
    if run and run == done.run:
        return done
    made_of = failure.get("made_of") or {}
    failed = replace(
        done,
        failed_run=run,
        has_failed=True,
        code=encodable(failure.get("code") or "unknown"),
        reason=encodable(failure.get("reason") or ""),
        labpipe=encodable(failure.get("labpipe") or done.labpipe),
    )
    try:
        inputs = _inputs(failure.get("inputs") or [])
        return replace(
            failed,
            inputs=inputs,
            sheet=encodable(made_of.get("sheet", "")),
            protocol_text=encodable(made_of.get("protocol", "")),
        )
    except (KeyError, TypeError, AttributeError):
        return failed


def _read_summary(path: Path) -> StoredOutcome:
    content = _read_object(path)
    if content is None:
        return StoredOutcome(unreadable=f"{SUMMARY_FILE} cannot be read")
    if isinstance(content.get("schema"), int) and content["schema"] > SUMMARY_SCHEMA:
        reason = error_text(
            path,
            "schema",
            expected=f"{SUMMARY_SCHEMA} or less",
            found=str(content["schema"]),
            remedy="A newer labpipe made it: use that version.",
        )
        return StoredOutcome(has_failed=True, code=NEWER_RESULT, reason=reason)
    try:
        return _parse_outcome(content)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        return StoredOutcome(unreadable=f"{SUMMARY_FILE} is damaged ({error})")


def _parse_outcome(content: Mapping[str, Any]) -> StoredOutcome:
    made_of = content.get("made_of") or {}
    results = tuple(_result_row(entry) for entry in content["results"])
    doubted = next((result for result in results if result.status != "ok"), None)
    return StoredOutcome(
        test=encodable(content["test"]),
        protocol=encodable(content["protocol"]),
        date=encodable(content.get("date") or ""),
        operator=encodable(content.get("operator") or ""),
        labpipe=encodable(content["labpipe"]),
        specimen={**dict.fromkeys(_SPECIMEN, ""), **content["specimen"]},
        run=encodable(content["run"]),
        code="" if doubted is None else doubted.code,
        reason="" if doubted is None else f"{doubted.name}: {doubted.reason}",
        sheet=encodable(made_of.get("sheet", "")),
        protocol_text=encodable(made_of.get("protocol", "")),
        inputs=_inputs(content["inputs"]),
        results=results,
    )


def _inputs(entries: Iterable[Mapping[str, Any]]) -> tuple[tuple[str, str, str], ...]:
    return tuple(
        (encodable(entry["role"]), encodable(entry["file"]), encodable(entry["sha256"]))
        for entry in entries
    )


def _result_row(entry: Mapping[str, Any]) -> ResultRow:
    reasons = entry["reasons"]
    numbers = [_number(entry[key]) for key in ("value", "lower", "upper", "level", "estimate")]
    value, lower, upper, level, estimate = numbers
    seal = encodable(entry.get("seal") or "")
    if seal and seal != sealed(entry):
        message = f"the numbers of {entry['name']} were changed"
        raise ValueError(message)
    return ResultRow(
        name=encodable(entry["name"]),
        value=value,
        unit=encodable(entry["unit"]),
        lower=lower,
        upper=upper,
        level=level,
        estimate=estimate,
        status=encodable(entry["status"]),
        code=encodable(", ".join(str(reason["code"]) for reason in reasons)),
        reason=encodable("; ".join(str(reason["message"]) for reason in reasons)),
        seal=seal,
    )


def _number(value: object) -> float | None:
    return None if value is None else float(str(value))


def _read_object(path: Path) -> dict[str, Any] | None:
    """Read the object of a JSON file; return None for anything else."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None
