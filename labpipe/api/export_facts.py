"""What an export holds, as an object: what ``labpipe inspect`` prints."""

from __future__ import annotations

import os
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from labpipe.api.data_frames import Recordings, quality_frame
from labpipe.process.inspection import Inspection, as_json, as_text, inspect_export


def inspect(file: str | os.PathLike[str]) -> Export:
    """Say what an export holds: program, channels, rates, gaps, oddities; nothing is processed.

    Parameters
    ----------
    file : the export; its format is recognised by its content

    Returns
    -------
    The facts; printed, they are what ``labpipe inspect`` prints.

    Raises
    ------
    ReadError
        If the file is of no known format, or too damaged to be read at all.

    Examples
    --------
    >>> labpipe.inspect("take.csv").channels  # doctest: +SKIP
    """
    return Export(inspect_export(Path(file)))


class Export:
    """An export and what its reader made of it.

    Parameters
    ----------
    inspection : of the export
    """

    def __init__(self, inspection: Inspection) -> None:
        self._inspection = inspection

    @property
    def file(self) -> Path:
        """The export."""
        return self._inspection.file

    @cached_property
    def facts(self) -> dict[str, Any]:
        """What ``labpipe inspect --json`` prints."""
        return dict(as_json(self._inspection))

    @property
    def channels(self) -> pd.DataFrame:
        """The channels of all clocks.

        ``clock``, ``name``, ``path``, ``unit`` (SI where the export says one, else none),
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
        """What the reader noticed: ``code``, ``severity``, ``where``, ``message``."""
        return quality_frame(self._inspection.recording.notes)

    @property
    def data(self) -> Recordings:
        """The recording as tables, by the name of the file without its ending, as `Test.raw`."""
        return Recordings({self.file.stem: self._inspection.recording})

    def __repr__(self) -> str:
        return as_text(self._inspection)
