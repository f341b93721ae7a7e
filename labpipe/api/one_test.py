"""A processed test and an export, for Python and notebooks."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from labpipe.api.data_frames import (
    PARTS,
    Recordings,
    Units,
    make_budget_frame,
    make_curve_frame,
    make_dataset,
    make_quality_frame,
    make_results_frame,
    make_shape_frame,
)
from labpipe.errors import ProcessingError, UsageError, nearest
from labpipe.process.inspection import Inspection, as_json, as_text, inspect_export
from labpipe.records.quality import Severity
from labpipe.records.result import Result, Status, TestResult
from labpipe.report.wording import (
    as_label,
    count_of,
    is_main,
    printable,
    shown_in,
    unit_words,
    write_number,
)
from labpipe.store.summaries import summary

if TYPE_CHECKING:
    import datetime

    import pandas as pd
    from xarray import Dataset

    from labpipe.records.result import Instrument, Result, Specimen
    from labpipe.report.figures import Figure


class Test:
    """A processed test: numbers, curve, shapes, recordings, notes and figures.

    `labpipe.open` and `labpipe.process` make it. All numbers are in SI units; `display` is
    the same test in the units of its protocol (mm, mJ ...).

    Parameters
    ----------
    outcome : the processed test; shapes and recordings may be missing if `whole` has them
    whole : reads the complete test on first use
    folder : of its files; None if there are none
    units : of the numbers
    """

    __test__ = False  # pytest must not collect it

    def __init__(
        self,
        outcome: TestResult,
        *,
        read_full: Callable[[], TestResult] | None = None,
        folder: Path | None = None,
        units: Units | None = None,
    ) -> None:
        self._outcome = outcome
        self._read_full = read_full
        self._units = units or Units()
        self.folder = folder

    @cached_property
    def _full(self) -> TestResult:
        return self._outcome if self._read_full is None else self._read_full()

    @property
    def name(self) -> str:
        """Return the name of the test."""
        return self._outcome.test

    @property
    def protocol(self) -> str:
        """Return the name of its protocol."""
        return self._outcome.protocol

    @property
    def specimen(self) -> Specimen:
        """Return the specimen; dimensions in m."""
        return self._outcome.specimen

    @property
    def date(self) -> datetime.date | None:
        """Return the day of the test; None if neither sheet nor exports state it."""
        return self._outcome.date

    @property
    def operator(self) -> str:
        """Return the person who ran the test; empty if the sheet does not state it."""
        return self._outcome.operator

    @property
    def instruments(self) -> tuple[Instrument, ...]:
        """Return the instruments whose certificates the protocol states."""
        return self._outcome.instruments

    @property
    def summary(self) -> dict[str, object]:
        """Return the content of ``summary.json``, in SI units."""
        return summary(self._outcome)

    @property
    def display(self) -> Test:
        """Return the same test with numbers in the display units of its protocol."""
        return Test(
            self._outcome,
            read_full=lambda: self._full,
            folder=self.folder,
            units=Units(dict(self._outcome.display)),
        )

    @property
    def results(self) -> pd.DataFrame:
        """Return the results, in the order of the protocol.

        By ``name``: ``value``, ``estimate``, ``lower``, ``upper`` (ends of the 95 % interval; NaN
        where not available), ``unit``, ``status``, ``code``, ``reason``.
        """
        return make_results_frame(self._outcome.results, self._units)

    def budget(self, name: str) -> pd.DataFrame:
        """Return the contributions to the interval of a result.

        Parameters
        ----------
        name : of the result, such as ``peak_force.1``

        Returns
        -------
        By ``cause``: ``change`` of the result by one standard uncertainty of the cause, ``share``
        of the variance, ``is_common`` (to all tests of a rig). Empty if not known.

        Raises
        ------
        UsageError
            If the test has no such result.
        """
        return make_budget_frame(self._result(name), self._units)

    def _result(self, name: str) -> Result:
        results = {result.name: result for result in self._outcome.results}
        if name not in results:
            raise self._unknown("result", name, list(results))
        return results[name]

    @property
    def curve(self) -> pd.DataFrame:
        """Return the force against displacement, after all steps and corrections.

        ``time``, ``displacement``, ``force``, ``branch`` (from 0 in order of travel, -1 outside)
        and ``cycle`` (from 1, 0 outside); units in ``attrs["units"]``.

        Raises
        ------
        ProcessingError
            If the test has no curve.
        """
        if self._outcome.curve is None:
            raise self._missing("curve")
        return make_curve_frame(self._outcome.curve, self._units)

    @property
    def shape(self) -> pd.DataFrame:
        """Return the positions along the specimen by ``time``, in columns (point, axis).

        x is along the undeformed specimen from the clamped end, y in the plane of bending.

        Raises
        ------
        ProcessingError
            If the test has no shapes.
        """
        shape = self._full.shape
        if shape is None:
            raise self._missing("shape")
        return make_shape_frame(shape, self._units)

    @property
    def raw(self) -> Recordings:
        """Return the recordings as tables by role: ``test.raw["force"]``; in SI, not calibrated."""
        return Recordings(self._full.recordings)

    @property
    def quality(self) -> pd.DataFrame:
        """Return the quality notes: ``code``, ``severity``, ``where``, ``message``."""
        return make_quality_frame(self._outcome.quality)

    @property
    def figures(self) -> tuple[str, ...]:
        """Return the names of the figures of the protocol."""
        return self._outcome.figures

    def figure(self, name: str) -> Figure:
        """Draw a figure.

        Parameters
        ----------
        name : such as ``force-displacement``; `figures` lists those of the protocol, but any may be
            drawn

        Returns
        -------
        A matplotlib figure, which a notebook shows. It states if its data is missing.

        Raises
        ------
        UsageError
            If there is no such figure.
        """
        from labpipe.report.figures import FIGURES, draw_figure

        if name not in FIGURES:
            raise self._unknown("figure", name, list(FIGURES))
        return draw_figure(self._full, name)

    def dataset(self, part: str) -> Dataset:
        """Return a part of the test as an xarray Dataset with axes and units, in SI.

        Parameters
        ----------
        part : ``curve``, ``aligned``, ``shape``, ``bending``, ``law`` or the role of a recording

        Raises
        ------
        UsageError
            If xarray is not installed, or there is no such part.
        ProcessingError
            If the test does not have it.
        """
        parts = [*PARTS, *self._full.recordings]
        if part not in parts:
            raise self._unknown("part", part, parts)
        dataset = make_dataset(self._full, part)
        if dataset is None:
            raise self._missing(part)
        return dataset

    def __repr__(self) -> str:
        return f"<labpipe test {self.name} ({self.protocol}): {self._status_counts}>"

    @property
    def _status_counts(self) -> str:
        counts = Counter(result.status for result in self._outcome.results)
        return (
            ", ".join(f"{counts[status]} {status}" for status in Status if counts[status])
            or "nothing"
        )

    def _repr_html_(self) -> str:
        return format_html(self._outcome)

    def _unknown(self, what: str, name: str, names: list[str]) -> UsageError:
        if not names:
            return UsageError.about("api.none_of_these", self.name, what=what)
        examples = ", ".join(nearest(name, names, limit=7))
        return UsageError.about("api.unknown", self.name, what=what, names=examples, found=name)

    def _missing(self, what: str) -> ProcessingError:
        notes = self._outcome.quality
        why = next((note.message for note in notes if note.severity is Severity.ERROR), "")
        remedy = f"Why: {why.rstrip('.')}." if why else _NOT_ASKED_FOR
        return ProcessingError.about("api.missing_part", self.name, what=what, remedy=remedy)


_NOT_ASKED_FOR = "Its protocol does not ask for one, or see `quality`."
_CELL = "text-align:left;padding:1px 12px 1px 0"


def format_html(result: TestResult) -> str:
    """Return the HTML of a test for a notebook.

    Parameters
    ----------
    result : the processed test

    Returns
    -------
    A heading, the first results in display units with intervals, and counts of problems.
    """
    # Results that are shown; the rest are counted.
    max_rows = 10
    main = [result for result in result.results if is_main(result.name)] or list(result.results)
    rows = [_row(shown, result) for shown in main[:max_rows]]
    more = len(result.results) - len(rows)
    lines = [
        f"<strong>{_safe(result.test)}</strong> {_safe(_what(result))}",
        f'<table style="border-collapse:collapse">{"".join(rows)}</table>' if rows else "",
        f"<small>{_safe(_rest(result, more))}</small>",
    ]
    return f"<div>{''.join(f'<div>{line}</div>' for line in lines if line)}</div>"


def _safe(text: str) -> str:
    return escape(printable(text))


def _what(result: TestResult) -> str:
    specimen = result.specimen
    parts = [result.protocol, f"{specimen.type}, spool {specimen.spool}, sample {specimen.sample}"]
    parts += [str(result.date)] if result.date else []
    return " · ".join([*parts, *filter(None, [result.operator])])


def _row(result: Result, test: TestResult) -> str:
    factor, unit = shown_in(result.name, result.unit, test.display)
    value = float("nan") if result.value is None else result.value
    written = write_number(value, result.interval, factor, estimate=result.distinct_estimate)
    number = f"{written.value} {unit_words(unit)}" if result.value is not None else written.value
    state = "" if result.status is Status.OK else f"{result.status}: {result.why}"
    cells = [as_label(result.name), number, written.interval, state]
    inner = "".join(f'<td style="{_CELL}">{_safe(cell)}</td>' for cell in cells)
    return f"<tr>{inner}</tr>"


def _rest(result: TestResult, more: int) -> str:
    severities = Counter(note.severity for note in result.quality)
    parts = [f"95 % intervals; {more} more in .results" if more > 0 else "95 % intervals"]
    parts += [
        count_of(severities[severity], severity.value)
        for severity in (Severity.ERROR, Severity.WARNING)
        if severities[severity]
    ]
    return ", ".join(parts) + (" in .quality" if len(parts) > 1 else "")


def inspect(file: str | os.PathLike[str]) -> Export:
    """Read facts about an export: program, channels, rates, gaps, oddities.

    Parameters
    ----------
    file : the export; its format is recognised by its content

    Returns
    -------
    The facts; ``print`` shows them as ``labpipe inspect`` does.

    Raises
    ------
    ReadError
        If the format is unknown, or the file is too damaged to read.

    Examples
    --------
    >>> labpipe.inspect("take.csv").channels  # doctest: +SKIP
    """
    return Export(inspect_export(Path(file)))


class Export:
    """An export as its reader understands it.

    Parameters
    ----------
    inspection : of the export
    """

    def __init__(self, inspection: Inspection) -> None:
        self._inspection = inspection

    @property
    def file(self) -> Path:
        """Return the export."""
        return self._inspection.file

    @cached_property
    def facts(self) -> dict[str, Any]:
        """Return the output of ``labpipe inspect --json``."""
        return dict(as_json(self._inspection))

    @property
    def channels(self) -> pd.DataFrame:
        """Return the channels of all clocks.

        ``clock``, ``name``, ``path``, ``unit`` (SI if the export states one, else none),
        ``unit_in_file``, ``first``, ``last``, ``min``, ``max`` (float64) and ``missing`` (samples).
        """
        rows = [
            {"clock": stream["clock"], **channel}
            for stream in self.facts["streams"]
            for channel in stream["channels"]
        ]
        texts = ("clock", "name", "path", "unit", "unit_in_file")
        numbers = ("first", "last", "min", "max")
        frame = pd.DataFrame(rows, columns=[*texts, *numbers, "missing"])
        kinds = dict.fromkeys(texts, "str") | dict.fromkeys(numbers, "float64")
        return frame.astype(kinds | {"missing": "int64"})

    @property
    def notes(self) -> pd.DataFrame:
        """Return the notes of the reader: ``code``, ``severity``, ``where``, ``message``."""
        return make_quality_frame(self._inspection.recording.notes)

    @property
    def data(self) -> Recordings:
        """Return the recording as tables by file name without its ending, like `Test.raw`."""
        return Recordings({self.file.stem: self._inspection.recording})

    def __repr__(self) -> str:
        return as_text(self._inspection)
