"""From the files of a test to its rows of the catalog: summary.json, failure.json."""

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
from labpipe.store.failure_file import FAILURE_FILE
from labpipe.store.summaries import SUMMARY_SCHEMA, sealed

NEWER_RESULT: Final = "newer_result"
"""Code of a test whose results are of a labpipe newer than this one; they are left alone."""
_SPECIMEN = ("type", "spool", "sample")


@dataclass(frozen=True, slots=True)
class ResultRow:
    """A result as the catalog has it; numbers are SI, None where they are not available.

    Parameters
    ----------
    name, value, unit, lower, upper, level, estimate, status : as in summary.json
    code, reason : why it is doubtful or failed, codes and sentences; empty where it is neither
    seal : SHA-256 over its numbers; empty where summary.json has none
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
    """What the files of a test say of it.

    Parameters
    ----------
    test, protocol, date, operator, labpipe : as in summary.json; empty where nothing says them
    specimen : all that summary.json says of it
    run : key of the results; empty where there are none
    failed_run : key of the last attempt, where that failed; may be empty even then
    has_failed : whether the last attempt failed
    code, reason : why it failed, or the first result is doubtful; empty where neither is so
    sheet, protocol_text : SHA-256 of test sheet and resolved protocol; empty where not known
    inputs : role, file and SHA-256 of the exports
    results : of the last attempt that did not fail
    unreadable : what is wrong with summary.json; empty where it is whole or not there
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
        """Key of the last attempt."""
        return self.failed_run if self.has_failed else self.run


def plain(said: object) -> str:
    """Text that every file and data base takes: half characters are written out.

    Parameters
    ----------
    said : text, or what has a text
    """
    return str(said).encode("utf-8", "backslashreplace").decode()


def read_outcome_files(files: OutcomeFiles | None) -> StoredOutcome:
    """Read what became of a test.

    Parameters
    ----------
    files : as they lie; None for none

    Returns
    -------
    The outcome. A failure of the very key that the results have is an older attempt, which is left
    out: a process was killed between the results and taking it away.
    """
    if files is None:
        return StoredOutcome()
    done = _summary(files.folder / SUMMARY_FILE) if files.has_results else StoredOutcome()
    if not files.has_results and f"{SUMMARY_FILE}:" in files.marks:
        done = StoredOutcome(unreadable=f"{RESULT_FILE} is gone")
    if not files.has_failure:
        return done
    return _failed(done, _object(files.folder / FAILURE_FILE) or {})


def _failed(done: StoredOutcome, said: Mapping[str, Any]) -> StoredOutcome:
    run = plain(said.get("run") or "")
    if run and run == done.run:
        return done
    made_of = said.get("made_of") or {}
    failed = replace(
        done,
        failed_run=run,
        has_failed=True,
        code=plain(said.get("code") or "unknown"),
        reason=plain(said.get("reason") or ""),
        labpipe=plain(said.get("labpipe") or done.labpipe),
    )
    try:
        inputs = _inputs(said.get("inputs") or [])
        return replace(
            failed,
            inputs=inputs,
            sheet=plain(made_of.get("sheet", "")),
            protocol_text=plain(made_of.get("protocol", "")),
        )
    except (KeyError, TypeError, AttributeError):
        return failed


def _summary(path: Path) -> StoredOutcome:
    said = _object(path)
    if said is None:
        return StoredOutcome(unreadable=f"{SUMMARY_FILE} cannot be read")
    if isinstance(said.get("schema"), int) and said["schema"] > SUMMARY_SCHEMA:
        reason = error_text(
            path,
            "schema",
            expected=f"{SUMMARY_SCHEMA}, or one before it",
            found=str(said["schema"]),
            remedy="A newer labpipe made it: use that one.",
        )
        return StoredOutcome(has_failed=True, code=NEWER_RESULT, reason=reason)
    try:
        return _outcome(said)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        return StoredOutcome(unreadable=f"{SUMMARY_FILE} lacks something ({error})")


def _outcome(said: Mapping[str, Any]) -> StoredOutcome:
    made_of = said.get("made_of") or {}
    results = tuple(_row(entry) for entry in said["results"])
    doubted = next((result for result in results if result.status != "ok"), None)
    return StoredOutcome(
        test=plain(said["test"]),
        protocol=plain(said["protocol"]),
        date=plain(said.get("date") or ""),
        operator=plain(said.get("operator") or ""),
        labpipe=plain(said["labpipe"]),
        specimen={**dict.fromkeys(_SPECIMEN, ""), **said["specimen"]},
        run=plain(said["run"]),
        code="" if doubted is None else doubted.code,
        reason="" if doubted is None else f"{doubted.name}: {doubted.reason}",
        sheet=plain(made_of.get("sheet", "")),
        protocol_text=plain(made_of.get("protocol", "")),
        inputs=_inputs(said["inputs"]),
        results=results,
    )


def _inputs(said: Iterable[Mapping[str, Any]]) -> tuple[tuple[str, str, str], ...]:
    return tuple(
        (plain(sentence["role"]), plain(sentence["file"]), plain(sentence["sha256"]))
        for sentence in said
    )


def _row(entry: Mapping[str, Any]) -> ResultRow:
    said = entry["reasons"]
    numbers = [_number(entry[key]) for key in ("value", "lower", "upper", "level", "estimate")]
    value, lower, upper, level, estimate = numbers
    seal = plain(entry.get("seal") or "")
    if seal and seal != sealed(entry):
        message = f"the numbers of {entry['name']} as they were written"
        raise ValueError(message)
    return ResultRow(
        name=plain(entry["name"]),
        value=value,
        unit=plain(entry["unit"]),
        lower=lower,
        upper=upper,
        level=level,
        estimate=estimate,
        status=plain(entry["status"]),
        code=plain(", ".join(str(sentence["code"]) for sentence in said)),
        reason=plain("; ".join(str(sentence["message"]) for sentence in said)),
        seal=seal,
    )


def _number(value: object) -> float | None:
    return None if value is None else float(str(value))


def _object(path: Path) -> dict[str, Any] | None:
    """The object of a JSON file; None where it is none."""
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return said if isinstance(said, dict) else None
