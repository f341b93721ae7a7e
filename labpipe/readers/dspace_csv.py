"""Reader of dSPACE ControlDesk recordings saved as CSV.

**Writes this file**: ControlDesk, "export as CSV".

**Recording**: one channel per trace, all on the clock of the first trace.

**Units**: not set; no known file states them, the protocol must.

**Missing data**: blank cells become NaN; ``Infinity`` becomes NaN and is noted.

**Clock and frame**: the first, unnamed trace exactly as written.

**File structure**: rows of properties (section, group, key, value; then one row per property of
the traces, its name in the first cell), then ``trace_values`` opens the samples on the same line;
later lines begin with an empty cell.

**Known versions**: ControlDesk 25.1.
"""

from __future__ import annotations

import csv
import io
from codecs import BOM_UTF8
from collections.abc import Mapping, Sequence
from datetime import UTC, date, datetime
from pathlib import Path

from labpipe.readers.channels import ReportOptions
from labpipe.readers.controldesk import Export, Trace, load_export, written_date
from labpipe.readers.number_table import Body, read_columns
from labpipe.readers.raw_files import read_head, reading, unreadable
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote
from labpipe.records.recording import Recording
from labpipe.units import whole_number

_SAMPLES_MARK = b"trace_values"
_NAMES = "trace_names"
_EXPORT_AGAIN = "Export the recording from ControlDesk as CSV again."
_TRACE_PROPERTIES = (
    *("devices", "raster", "description", "displayidentifier", "path", "flags"),
    *("min", "max", "minWeak", "maxWeak"),
)


def recognise(path: Path) -> bool:
    """Return whether a file is a ControlDesk CSV, by its first cells."""
    lines = read_head(path).removeprefix(BOM_UTF8).splitlines()
    return any(line.startswith((b"descriptions,", b"trace_")) for line in lines)


def read(path: Path, *, channels: Sequence[ReportOptions] | None = None) -> Recording:
    """Read a ControlDesk CSV file.

    Parameters
    ----------
    path : the export
    channels : names or paths wanted, None for all

    Returns
    -------
    The recording.

    Raises
    ------
    ReadError
        If a row of properties, the samples or a wanted channel is missing or damaged.
    """
    read_head(path)
    with reading(path, "a readable file"):
        content = path.read_bytes().removeprefix(BOM_UTF8)
    start = _samples_offset(content, path)
    with reading(path, "rows of properties"):
        text = content[:start].decode("utf-8", errors="replace")
        rows = list(csv.reader(io.StringIO(text, newline="")))
    traces = _properties(rows, path)
    samples, notes = _samples(content, start, traces, path)
    export = _export(rows, traces, samples, notes)
    return load_export(export, reader="dspace-csv", path=path, channels=channels)


def _samples_offset(content: bytes, path: Path) -> int:
    """Return the offset of the line that begins the samples."""
    start = 0 if content.startswith(_SAMPLES_MARK) else content.find(b"\n" + _SAMPLES_MARK) + 1
    if start or content.startswith(_SAMPLES_MARK):
        return start
    last_line = content.count(b"\n") + 1
    place = f"line {last_line}"
    raise unreadable(path, place, "a line that begins with trace_values", "none", _EXPORT_AGAIN)


def _properties(rows: Sequence[Sequence[str]], path: Path) -> dict[str, list[str]]:
    """Return properties of the traces by the first cell of their row, one value per trace."""
    properties = {row[0]: list(row[1:]) for row in rows if row and row[0]}
    if len(properties.get(_NAMES, [])) < 1:
        raise unreadable(
            path,
            f"lines 1 to {len(rows)}",
            "a row trace_names with one cell per trace",
            "none",
            _EXPORT_AGAIN,
        )
    width = len(properties[_NAMES])
    return {key: (cells + [""] * width)[:width] for key, cells in properties.items()}


def _samples(
    content: bytes, start: int, traces: Mapping[str, list[str]], path: Path
) -> tuple[Mapping[int, Floats], list[QualityNote]]:
    """Return all traces by number; the first cell of a line is not a sample."""
    size = traces.get("trace_size", [""])[0]
    width = len(traces[_NAMES])
    body = Body(
        data=content[start + len(_SAMPLES_MARK) :],
        names=("", "time", *traces[_NAMES][1:]),
        columns=range(1, width + 1),
        first_line=content[:start].count(b"\n") + 1,
        separator=",",
        decimal=".",
        stated_rows=whole_number(size),
        as_exported=True,
    )
    return read_columns(body, path)


def _export(
    rows: Sequence[Sequence[str]],
    traces: Mapping[str, list[str]],
    samples: Mapping[int, Floats],
    notes: Sequence[QualityNote],
) -> Export:
    about = _descriptions(rows)
    general, measurement = about.get("General", {}), about.get("Measurement", {})
    saved = _reference_day(measurement.get("ReferenceTime", ""))
    day = written_date(general.get("DateTime", ""), saved)
    raster = traces.get("raster", [""])[0]
    return Export(
        axes=[(raster, lambda: samples[1])],
        traces=[_trace(traces, i, samples) for i in range(1, len(traces[_NAMES]))],
        origin=general.get("Origin", ""),
        metadata={"date": day, **about},
        notes=notes,
        start=None,  # the axis begins at 0 whatever StartTimestamp says (25.1)
    )


def _trace(traces: Mapping[str, list[str]], i: int, samples: Mapping[int, Floats]) -> Trace:
    name = traces[_NAMES][i]
    folder = traces.get("path", [""] * (i + 1))[i]
    return Trace(
        name=name,
        path=f"{folder}/{name}" if folder else name,
        unit_in_file=traces.get("trace_units", [""] * (i + 1))[i],
        clock=0,
        load=lambda: samples[i + 1],
        about={key: traces[key][i] for key in _TRACE_PROPERTIES if key in traces},
    )


def _descriptions(rows: Sequence[Sequence[str]]) -> dict[str, dict[str, str]]:
    """Return the values of the description rows by group and key."""
    about: dict[str, dict[str, str]] = {}
    for row in rows:
        if len(row) >= 4 and row[1] and row[0] in {"descriptions", ""}:
            about.setdefault(row[1], {})[row[2]] = row[3]
    return about


def _reference_day(nanoseconds: str) -> date | None:
    """Return the day of ReferenceTime, ns since 1970 UTC."""
    seconds = whole_number(nanoseconds[:-9])
    if seconds is None or len(nanoseconds) > 19:
        return None
    return datetime.fromtimestamp(seconds, tz=UTC).date()
