"""Give access to a processed test, and to an export before processing, in Python and notebooks."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from labpipe.api import data_frames
from labpipe.errors import ProcessingError, UsageError, sort_by_likeness
from labpipe.process.inspection import (
    Inspection,
    format_inspection,
    inspect_export,
    make_inspection_record,
)
from labpipe.records.quality import Severity
from labpipe.records.result import Status, TestResult
from labpipe.report.wording import replace_unprintable
from labpipe.store.summaries import build_summary

if TYPE_CHECKING:
    import datetime

    from labpipe.records.result import Instrument, Specimen
    from labpipe.report.figures import Figure


class Test:
    """Processed test: results, curve, shapes, recordings, notes and figures.

    `labpipe.open` and `labpipe.process` return such a test. All values are in SI units. `display`
    is the same test in the units of its protocol (mm, mJ ...).

    Parameters
    ----------
    outcome : processed test; if `read_full` is given, without shapes and recordings
    read_full : function that reads the complete test; it is called when shapes or recordings are
        needed for the first time. None if `outcome` is complete
    folder : folder with the files of the test; None for a test in memory
    units : units of the values; None for SI
    """

    __test__ = False  # pytest must not collect it

    def __init__(
        self,
        outcome: TestResult,
        *,
        read_full: Callable[[], TestResult] | None = None,
        folder: Path | None = None,
        units: data_frames.Units | None = None,
    ) -> None:
        self._outcome = outcome
        self._read_full = read_full
        self._units = units or data_frames.Units()
        self.folder = folder

    @cached_property
    def _full_outcome(self) -> TestResult:
        """Return the complete test, which is read on first use."""
        return self._outcome if self._read_full is None else self._read_full()

    @property
    def name(self) -> str:
        """Return the name of the test."""
        return self._outcome.test

    @property
    def protocol(self) -> str:
        """Return the name of the protocol."""
        return self._outcome.protocol

    @property
    def specimen(self) -> Specimen:
        """Return the specimen, with dimensions in m."""
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
        return build_summary(self._outcome)

    @property
    def display(self) -> Test:
        """Return the same test with values in the display units of its protocol."""
        folder, units = self.folder, data_frames.Units(dict(self._outcome.display))
        return Test(self._outcome, read_full=lambda: self._full_outcome, folder=folder, units=units)

    @property
    def results(self) -> pd.DataFrame:
        """Return the results in the order of the protocol.

        The index is ``name``. The columns are ``value``, ``estimate``, ``lower``, ``upper`` (ends
        of the 95 % interval; NaN if not available), ``unit``, ``status``, ``code``, ``reason``.
        """
        return data_frames.make_results_frame(self._outcome.results, self._units)

    def budget(self, name: str) -> pd.DataFrame:
        """Return the contributions to the interval of a result.

        Parameters
        ----------
        name : name of the result, such as ``peak_force.1``

        Returns
        -------
        Table with index ``cause`` and columns ``change`` (change of the result by one standard
        uncertainty of the cause), ``share`` (fraction of the variance) and ``is_common`` (whether
        the cause is common to all tests of a rig). It is empty if the result has no budget.

        Raises
        ------
        UsageError
            If the test has no such result.
        """
        results = {result.name: result for result in self._outcome.results}
        if name not in results:
            raise self._build_name_error("result", name, list(results))
        return data_frames.make_budget_frame(results[name], self._units)

    @property
    def curve(self) -> pd.DataFrame:
        """Return force against displacement after all steps and corrections.

        The columns are ``time``, ``displacement``, ``force``, ``branch`` (counted from 0; -1
        outside of every branch) and ``cycle`` (counted from 1; 0 outside of every cycle). Units are
        in ``attrs["units"]``.

        Raises
        ------
        ProcessingError
            If the test has no curve.
        """
        if self._outcome.curve is None:
            raise self._build_absence_error("curve")
        return data_frames.make_curve_frame(self._outcome.curve, self._units)

    @property
    def shape(self) -> pd.DataFrame:
        """Return the positions along the specimen, with index ``time`` and columns (point, axis).

        x is along the undeformed specimen from the clamped end, y in the plane of bending.

        Raises
        ------
        ProcessingError
            If the test has no shapes.
        """
        shape = self._full_outcome.shape
        if shape is None:
            raise self._build_absence_error("shape")
        factor, unit = self._units.choose_quantity_scale("displacement", "m")
        positions = factor * shape.positions
        return data_frames.make_position_frame(shape.time, shape.names, positions, "point", unit)

    @property
    def raw(self) -> data_frames.Recordings:
        """Return the recordings as tables, keyed by role, such as ``test.raw["force"]``.

        Values are in SI units if the export states a unit. They are not calibrated.
        """
        return data_frames.Recordings(self._full_outcome.recordings)

    @property
    def quality(self) -> pd.DataFrame:
        """Return the quality notes: ``code``, ``severity``, ``where``, ``message``."""
        return data_frames.make_quality_frame(self._outcome.quality)

    @property
    def figures(self) -> tuple[str, ...]:
        """Return the names of the figures of the protocol."""
        return self._outcome.figures

    def figure(self, name: str) -> Figure:
        """Draw a figure.

        Parameters
        ----------
        name : name of the figure, such as ``force-displacement``; the protocol need not list it

        Returns
        -------
        Matplotlib figure, which a notebook shows. A figure without data states the reason.

        Raises
        ------
        UsageError
            If there is no such figure.
        """
        from labpipe.report.figures import FIGURES, draw_figure

        if name not in FIGURES:
            raise self._build_name_error("figure", name, list(FIGURES))
        return draw_figure(self._full_outcome, name)

    def __repr__(self) -> str:
        return f"<labpipe test {self.name} ({self.protocol}): {self._format_counts()}>"

    def _format_counts(self) -> str:
        """Format the number of results of each status."""
        counts = Counter(result.status for result in self._outcome.results)
        texts = [f"{counts[status]} {status}" for status in Status if counts[status]]
        return ", ".join(texts) or "nothing"

    def _repr_html_(self) -> str:
        """Return the first results in display units as HTML, for a notebook."""
        max_rows = 10
        heading = f"{self.name} ({self.protocol}): {self._format_counts()}"
        columns = ["value", "lower", "upper", "unit", "status", "reason"]
        table = self.display.results[columns].head(max_rows)
        html = table.to_html(float_format="{:.4g}".format, na_rep="")
        return replace_unprintable(f"<div><strong>{escape(heading)}</strong></div>{html}")

    def _build_name_error(self, kind: str, name: str, names: list[str]) -> UsageError:
        """Build the error for an unknown name, with the most similar valid names."""
        if not names:
            return UsageError.about("api.none_of_kind", self.name, kind=kind)
        examples = ", ".join(sort_by_likeness(name, names, limit=7))
        return UsageError.about("api.unknown", self.name, kind=kind, names=examples, found=name)

    def _build_absence_error(self, stage: str) -> ProcessingError:
        """Build the error for a missing curve or shape, with the first error note."""
        notes = self._outcome.quality
        reason = next((note.message for note in notes if note.severity is Severity.ERROR), "")
        if not reason:
            return ProcessingError.about("api.not_in_protocol", self.name, stage=stage)
        reason = reason.rstrip(".")
        return ProcessingError.about("api.missing_stage", self.name, stage=stage, reason=reason)


def inspect(file: str | os.PathLike[str]) -> Export:
    """Read an export and describe its program, channels, rates, gaps and notes.

    Parameters
    ----------
    file : path of the export, whose format is recognised by its content

    Returns
    -------
    The export; ``print`` describes it as ``labpipe inspect`` does.

    Raises
    ------
    ReadError
        If the file is missing or too damaged to read, or its format is unknown.

    Examples
    --------
    >>> labpipe.inspect("take.csv").channels  # doctest: +SKIP
    """
    return Export(inspect_export(Path(file)))


class Export:
    """Export before processing, without protocol and test sheet: channels, notes and data.

    Parameters
    ----------
    inspection : inspection of the export
    """

    def __init__(self, inspection: Inspection) -> None:
        self._inspection = inspection

    @property
    def file(self) -> Path:
        """Return the path of the export."""
        return self._inspection.file

    @cached_property
    def facts(self) -> dict[str, Any]:
        """Return the output of ``labpipe inspect --json``."""
        return dict(make_inspection_record(self._inspection))

    @property
    def channels(self) -> pd.DataFrame:
        """Return the channels of all clocks.

        The columns are ``clock``, ``name``, ``path``, ``unit`` (SI; missing if the export states
        none), ``unit_in_file``, ``first``, ``last``, ``min``, ``max`` (float64) and ``missing``
        (number of missing samples).
        """
        rows = [
            {"clock": stream["clock"], **channel}
            for stream in self.facts["streams"]
            for channel in stream["channels"]
        ]
        text_columns = ("clock", "name", "path", "unit", "unit_in_file")
        value_columns = ("first", "last", "min", "max")
        frame = pd.DataFrame(rows, columns=[*text_columns, *value_columns, "missing"])
        types = dict.fromkeys(text_columns, "str") | dict.fromkeys(value_columns, "float64")
        return frame.astype(types | {"missing": "int64"})

    @property
    def notes(self) -> pd.DataFrame:
        """Return the notes of the reader: ``code``, ``severity``, ``where``, ``message``."""
        return data_frames.make_quality_frame(self._inspection.recording.notes)

    @property
    def data(self) -> data_frames.Recordings:
        """Return the recording as tables, like `Test.raw`; the role is the name of the file."""
        return data_frames.Recordings({self.file.stem: self._inspection.recording})

    def __repr__(self) -> str:
        return format_inspection(self._inspection)
