"""What is kept of reports, of a calibration and of wire models: one row for each number or array.

An array is kept as its mean, least and largest number, and their count. Words are left out, but for
verdicts.
"""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby
from math import fsum
from operator import itemgetter
from pathlib import Path
from typing import Any

from python_calamine import load_workbook

from labpipe.cli import main
from tests.golden.rows import Row

Entry = Mapping[str, Any]
LEFT_OUT = {"schema"}
EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "wires.xlsx"


def report_rows(workbook: Path, campaign: str) -> Iterator[Row]:
    """Means of groups, differences between them, places of bundles and mean curves."""
    book = load_workbook(str(workbook))
    for name in book.sheet_names:
        heads, *body = book.get_sheet_by_name(name).to_python()
        entries = [dict(zip(map(str, heads), row, strict=True)) for row in body]
        if name in TABLES:
            for entry in entries:
                yield from TABLES[name](campaign, entry)
        elif name in CURVES:
            for group, own in groupby(entries, key=itemgetter("group")):
                yield from _curve(f"{campaign} {CURVES[name]} {group}", list(own))


CURVES = {"curves": "curve", "scaled curves": "scaled"}


def _curve(name: str, entries: Sequence[Entry]) -> Iterator[Row]:
    for head in entries[0]:
        values: list[float] = [cell for entry in entries if isinstance(cell := entry[head], float)]
        if values:
            pure = "" if "(" in head or head == "n" else " (1)"
            yield _array(name, "curve", f"{head}{pure}", values)


def _group(campaign: str, entry: Entry) -> Iterator[Row]:
    if entry["over"] != "all":
        return
    where = (f"{campaign} {entry['group']}", "group", entry["result"])
    yield _number(*where, entry, "mean", n=entry["n"])
    yield from _more(*where, entry, {"standard deviation": "sd", "spools equal, p": "p"})


def _difference(campaign: str, entry: Entry) -> Iterator[Row]:
    pair = f"{campaign} {entry['first']} {entry['second']}"
    where = (pair, "difference", entry["result"])
    yield _number(*where, entry, "second minus first", status=str(entry["verdict"]))
    yield from _more(*where, entry, {"equivalent, p": "p"})


def _bundle(campaign: str, entry: Entry) -> Iterator[Row]:
    where = (f"{campaign} {entry['group']} {entry['test']}", "bundle", "bending_stiffness")
    yield _number(*where, entry, "bending stiffness")
    heads = ("all slips", "wires slip", "nothing slips")
    shares = ("share", "share lower", "share upper")
    named = {**{head: head for head in heads}, **{f"{head} (%)": head for head in shares}}
    yield from _more(*where, entry, {k: v.replace(" ", "_") for k, v in named.items()})


TABLES: Mapping[str, Callable[[str, Entry], Iterator[Row]]] = {
    "means": _group,
    "comparisons": _difference,
    "slipping and sticking": _bundle,
}


def study_rows(calibration: Path, model: Path) -> list[Row]:
    """Rows of the calibration of the demo, and of the wires of the examples."""
    return [
        row
        for kind, path in (("calibration", calibration), ("model", model))
        for row in json_rows("wires", kind, json.loads(path.read_text(encoding="utf-8")))
    ]


def made_model(folder: Path) -> Path:
    """Model the wires of the examples without figures; the JSON that comes out."""
    with contextlib.redirect_stdout(io.StringIO()):
        main(["model", str(EXAMPLES), "--no-figures", "--out", str(folder)])
    return folder / "model.json"


_PLAIN = str.maketrans({"\u00b7": "*", "\u00b2": "^2"})
"""Units as results have them."""


def _number(
    test: str, kind: str, name: str, entry: Entry, head: str, *, status: str = "", n: Any = ""
) -> Row:
    value, lower, upper = (_text(entry[key]) for key in (head, "lower", "upper"))
    count = "" if n == "" else str(int(n))
    unit = str(entry["unit"]).translate(_PLAIN) or "1"
    return Row(test, kind, name, status, "", unit, value, lower, upper, n=count)


def _more(test: str, kind: str, name: str, entry: Entry, heads: Mapping[str, str]) -> Iterator[Row]:
    for head, short in heads.items():
        if entry[head] != "":
            yield Row(test, kind, f"{name}.{short}", value=_text(entry[head]))


def json_rows(test: str, kind: str, document: Any, path: str = "") -> Iterator[Row]:
    """Numbers, arrays and verdicts of a JSON document, by their path in it."""
    match document:
        case bool() | str():
            if document in {True, False} or path.endswith(("verdict", "code")):
                yield Row(test, kind, path, status=str(document))
        case int() | float():
            yield Row(test, kind, path, value=_text(document))
        case [int() | float(), *_]:
            yield _array(test, kind, path, document)
        case dict() | list():
            for name, item in _parts(document):
                yield from json_rows(test, kind, item, f"{path}.{name}" if path else name)


def _parts(document: dict[str, Any] | list[Any]) -> Iterator[tuple[str, Any]]:
    if isinstance(document, dict):
        yield from ((name, item) for name, item in document.items() if name not in LEFT_OUT)
    else:
        yield from ((str(number), item) for number, item in enumerate(document))


def _array(test: str, kind: str, name: str, values: Sequence[float]) -> Row:
    mean, low, high = (
        _text(number) for number in (fsum(values) / len(values), min(values), max(values))
    )
    return Row(test, kind, name, value=mean, lower=low, upper=high, n=str(len(values)))


def _text(number: Any) -> str:
    return repr(float(number)) if isinstance(number, int | float) else ""
