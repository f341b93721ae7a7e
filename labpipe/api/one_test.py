"""A processed test for Python and notebooks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from labpipe.api.data_frames import (
    Recordings,
    Units,
    budget_frame,
    curve_frame,
    quality_frame,
    results_frame,
    shape_frame,
)
from labpipe.api.notebook_page import page_of
from labpipe.errors import ProcessingError, UsageError, error_text, nearest
from labpipe.records.quality import Severity
from labpipe.records.result import Status, TestResult
from labpipe.store.summaries import summary

if TYPE_CHECKING:
    import datetime

    import pandas as pd

    from labpipe.api.data_sets import Dataset
    from labpipe.records.result import Instrument, Result, Specimen
    from labpipe.report.figures import Figure

_RESULT, _FIGURE, _PART, _CURVE, _SHAPE = "result", "figure", "part", "curve", "shape"


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
        return results_frame(self._outcome.results, self._units)

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
        return budget_frame(self._result(name), self._units)

    def _result(self, name: str) -> Result:
        results = {result.name: result for result in self._outcome.results}
        if name not in results:
            raise self._unknown(_RESULT, name, list(results))
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
            raise self._missing(_CURVE)
        return curve_frame(self._outcome.curve, self._units)

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
            raise self._missing(_SHAPE)
        return shape_frame(shape, self._units)

    @property
    def raw(self) -> Recordings:
        """Return the recordings as tables by role: ``test.raw["force"]``; in SI, not calibrated."""
        return Recordings(self._full.recordings)

    @property
    def quality(self) -> pd.DataFrame:
        """Return the quality notes: ``code``, ``severity``, ``where``, ``message``."""
        return quality_frame(self._outcome.quality)

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
            raise self._unknown(_FIGURE, name, list(FIGURES))
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
        from labpipe.api.data_sets import PARTS, dataset_of

        parts = [*PARTS, *self._full.recordings]
        if part not in parts:
            raise self._unknown(_PART, part, parts)
        dataset = dataset_of(self._full, part)
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
        return page_of(self._outcome)

    def _unknown(self, what: str, name: str, names: list[str]) -> UsageError:
        examples = ", ".join(nearest(name, names, limit=7))
        text = error_text(
            self.name,
            "",
            expected=f"a {what} such as {examples}" if names else f"a {what}",
            found=repr(name) if names else "none",
            remedy="Choose one of these." if names else "Look at `quality`.",
        )
        return UsageError(text)

    def _missing(self, what: str) -> ProcessingError:
        notes = self._outcome.quality
        why = next((note.message for note in notes if note.severity is Severity.ERROR), "")
        remedy = (
            f"Why: {why.rstrip('.')}."
            if why
            else "Its protocol does not ask for one, or see `quality`."
        )
        return ProcessingError(
            error_text(self.name, "", expected=f"a {what}", found="none", remedy=remedy)
        )
