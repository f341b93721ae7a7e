"""Facts about an export, as ``labpipe inspect`` prints them."""

from __future__ import annotations

import os
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from labpipe.api.data_frames import Recordings, quality_frame
from labpipe.process.inspection import Inspection, as_json, as_text, inspect_export


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
        return quality_frame(self._inspection.recording.notes)

    @property
    def data(self) -> Recordings:
        """Return the recording as tables by file name without its ending, like `Test.raw`."""
        return Recordings({self.file.stem: self._inspection.recording})

    def __repr__(self) -> str:
        return as_text(self._inspection)
