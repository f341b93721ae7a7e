"""Writing and reading of summary.json."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from hashlib import sha256
from math import isfinite
from pathlib import Path
from typing import Any

from labpipe.errors import StoreError, error_text
from labpipe.records.harness_bundle import Bundle
from labpipe.records.result import Instrument, Result, Specimen, TestResult, seal_of
from labpipe.store.replace import replacing

SUMMARY_FILE = "summary.json"
SUMMARY_SCHEMA = 2


def summary(result: TestResult) -> dict[str, object]:
    """Return the summary of a test in SI numbers.

    Parameters
    ----------
    result : a processed test

    Returns
    -------
    The content of ``summary.json``. A number that is not finite or not available is None; status
    and reasons explain it.
    """
    return {
        "schema": SUMMARY_SCHEMA,
        "test": result.test,
        "specimen": _specimen(result.specimen),
        "protocol": result.protocol,
        "labpipe": result.labpipe_version,
        "inputs": [
            {"role": export.role, "file": export.file, "sha256": export.sha256}
            for export in result.inputs
        ],
        "date": None if result.date is None else str(result.date),
        "operator": result.operator,
        "instruments": [_instrument(instrument) for instrument in result.instruments],
        "run": result.run,
        "made_of": {
            "sheet": sha256(result.test_yaml.encode()).hexdigest(),
            "protocol": sha256(result.protocol_yaml.encode()).hexdigest(),
        },
        "results": [result_entry(entry) for entry in result.results],
        "quality": [
            {"code": note.code, "severity": str(note.severity), "message": note.message}
            for note in result.quality
        ],
    }


def write_summary(result: TestResult, path: Path) -> None:
    """Write ``summary.json``; an earlier one is kept until the new one is complete.

    Parameters
    ----------
    result : a processed test
    path : the file

    Raises
    ------
    StoreError
        If it cannot be written: full disk, no permission.
    """
    text = json.dumps(summary(result), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with replacing(path) as temporary:
        temporary.write_bytes(text.encode())


def _specimen(specimen: Specimen) -> dict[str, object]:
    content: dict[str, object] = {
        "type": specimen.type,
        "spool": specimen.spool,
        "sample": specimen.sample,
        **{name: finite_or_none(value) for name, value in specimen.dimensions.items()},
    }
    if specimen.bundle is not None:
        content["bundle"] = _bundle(specimen.bundle)
    if specimen.labels:
        content["labels"] = dict(specimen.labels)
    return content


def _bundle(bundle: Bundle) -> dict[str, object]:
    return {
        "composition": bundle.composition,
        "number": bundle.number,
        "wires": [
            {"type": wire.type, "number": wire.number, "diameter": finite_or_none(wire.diameter)}
            for wire in bundle.wires
        ],
        "arrangement": bundle.arrangement,
        "positions": [list(place) for place in bundle.positions],
        "tape": bundle.tape,
        "taping": bundle.taping,
        "conduit": bundle.conduit,
        "conduit_bore": finite_or_none(bundle.conduit_bore),
    }


def _instrument(instrument: Instrument) -> dict[str, object]:
    due = instrument.due
    return {
        "channel": instrument.channel,
        "measures": list(instrument.measures),
        "certificate": instrument.certificate,
        "calibrated": str(instrument.calibrated),
        "due": None if due is None else str(due),
        "uncertainty": finite_or_none(instrument.uncertainty),
        "k": instrument.k,
    }


def result_entry(result: Result) -> dict[str, object]:
    """Return a result as an entry of ``summary.json``.

    Parameters
    ----------
    result : of a test, or of a harness
    """
    interval = result.interval
    return {
        "name": result.name,
        "value": finite_or_none(result.value),
        "unit": result.unit,
        "lower": finite_or_none(interval.lower) if interval else None,
        "upper": finite_or_none(interval.upper) if interval else None,
        "level": finite_or_none(interval.level) if interval else None,
        "estimate": finite_or_none(result.likely),
        "status": str(result.status),
        "seal": result.seal,
        "code": ", ".join(result.codes),
        "reason": result.why,
        "reasons": [asdict(reason) for reason in result.reasons],
        "method": result.how,
        "budget": [
            {
                "cause": contribution.cause,
                "change": finite_or_none(contribution.change),
                "share": finite_or_none(share),
                "common": contribution.is_common,
            }
            for contribution, share in zip(result.budget, result.shares, strict=True)
        ],
    }


def check_summary(result: TestResult, path: Path) -> None:
    """Compare the numbers of a ``summary.json`` with those of its result file.

    Parameters
    ----------
    result : of the result file
    path : the summary; nothing is compared if it does not exist

    Raises
    ------
    StoreError
        If a result of the summary has another seal, or numbers that do not match its seal.
    """
    if not path.is_file():
        return
    seals = {entry.name: entry.seal for entry in result.results}
    for entry in read_summary(path)["results"]:
        if not entry["seal"] == sealed(entry) == seals.get(entry["name"]):
            raise StoreError(
                error_text(
                    path,
                    str(entry["name"]),
                    expected="the numbers of result.h5",
                    found="others: one of the files was changed",
                    remedy="Process the test again.",
                ),
                code="bad_result",
            )


def sealed(entry: Mapping[str, Any]) -> str:
    """Return the seal of the numbers of an entry of ``summary.json``.

    Parameters
    ----------
    entry : of `result_entry`
    """
    numbers = [entry[key] for key in ("value", "lower", "upper", "level", "estimate")]
    return seal_of(entry["name"], entry["unit"], entry["status"], numbers)


def finite_or_none(value: float | None) -> float | None:
    """Return the number; None for NaN and infinities, which JSON does not have."""
    return float(value) if value is not None and isfinite(value) else None


def read_summary(path: Path) -> dict[str, Any]:
    """Read a ``summary.json``.

    Parameters
    ----------
    path : the file

    Returns
    -------
    Its content.

    Raises
    ------
    StoreError
        If it cannot be read, is not a summary of labpipe, or is of another schema.
    """
    # A summary of a test of a hundred cycles has a hundredth of it.
    max_bytes = 1 << 26
    try:
        if not path.is_file() or path.stat().st_size > max_bytes:
            content = None
        else:
            content = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        raise _no_summary(path, f"a damaged one ({error})") from error
    if not isinstance(content, dict) or not isinstance(schema := content.get("schema"), int):
        raise _no_summary(path, "something else")
    if schema > SUMMARY_SCHEMA:
        raise _no_summary(path, f"one of a newer labpipe, schema {schema}", "Update labpipe.")
    if schema != SUMMARY_SCHEMA:
        raise _no_summary(path, f"one of schema {schema}")
    return content


def _no_summary(path: Path, found: str, remedy: str = "Process the test again.") -> StoreError:
    expected = "a summary of a processed test"
    return StoreError(error_text(path, "", expected=expected, found=found, remedy=remedy))
