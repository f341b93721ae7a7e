"""What is kept of a processed test: one row for each result, for each kind of note, and its own.

The files beside this module hold such rows as CSV, one file a campaign. They hold numbers, units
and codes; no sentence, so that a message may be worded afresh.
"""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any

import h5py


@dataclass(frozen=True)
class Row:
    """A result, a kind of note (`n` of them), or a test as a whole; numbers by their shortest form.

    `name` is that of the result, ``code.severity`` of the notes, or the protocol of the test.
    """

    test: str
    kind: str
    name: str
    status: str = ""
    codes: str = ""
    unit: str = ""
    value: str = ""
    lower: str = ""
    upper: str = ""
    level: str = ""
    n: str = ""

    @property
    def key(self) -> tuple[str, str, str]:
        return self.test, self.kind, self.name if self.kind != "test" else ""


COLUMNS = tuple(field.name for field in fields(Row))
NUMBERS = ("value", "lower", "upper", "level", "n")


def codes(reasons: Iterable[Mapping[str, str]]) -> str:
    """Codes of the reasons of a summary, in their order, each once."""
    return " ".join(dict.fromkeys(reason["code"] for reason in reasons))


def rows(test: str, folder: Path, *, status: str = "") -> list[Row]:
    """Everything that is kept of the test in a processed folder; one row where nothing came out."""
    path = folder / "summary.json"
    if not path.is_file():
        return [Row(test, "test", "", status=status or "none")]
    summary = json.loads(path.read_text(encoding="utf-8"))
    samples = _samples(folder / "result.h5")
    results = [_result(test, entry, samples) for entry in summary["results"]]
    whole = Row(test, "test", summary["protocol"], status=status, n=str(len(results)))
    return [whole, *results, *_notes(test, summary["quality"])]


def _result(test: str, entry: Mapping[str, Any], samples: Mapping[str, int]) -> Row:
    numbers = {name: _text(entry[name]) for name in ("value", "lower", "upper", "level")}
    return Row(
        test,
        "result",
        entry["name"],
        status=entry["status"],
        codes=codes(entry["reasons"]),
        unit=entry["unit"],
        n=_text(samples.get(entry["name"])),
        **numbers,
    )


def _notes(test: str, notes: Iterable[Mapping[str, str]]) -> Iterator[Row]:
    counted = Counter(f"{note['code']}.{note['severity']}" for note in notes)
    for name, number in sorted(counted.items()):
        yield Row(test, "note", name, n=str(number))


def _samples(path: Path) -> dict[str, int]:
    """How many samples each result rests on, by its name."""
    with h5py.File(path) as file:
        group = file["results"]
        return {name: int(group[name].attrs["n"]) for name in group.attrs["order"]}


def _text(number: float | None) -> str:
    return "" if number is None else repr(number)


def write(path: Path, kept: Iterable[Row]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(astuple(row) for row in kept)


def read(path: Path) -> list[Row]:
    """The rows of a file; none where there is no such file yet."""
    if not path.is_file():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return [Row(**row) for row in csv.DictReader(file)]
