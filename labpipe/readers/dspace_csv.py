"""Reader of dSPACE ControlDesk recordings saved as CSV.

**Writes this file**: ControlDesk, "export as CSV".

**Recording**: one channel for each trace after the first, which is the clock of all channels.

**Units**: from ``trace_units``. No known file has this property, so the protocol states the units.

**Missing data**: blank cells become NaN; ``Infinity`` becomes NaN, with a note.

**Clock and frame**: the times of the first trace, which has no name, exactly as written, or
converted to seconds if ``trace_units`` states another unit.

**File structure**: rows of properties of the recording (section, group, key, value), then one row
for each property of the traces, whose first cell is the name of the property. The line of the first
sample begins with ``trace_values``, and the lines of the other samples begin with an empty cell.

**Known versions**: ControlDesk 25.1.
"""

from __future__ import annotations

import csv
import io
from codecs import BOM_UTF8
from collections.abc import Mapping, Sequence
from datetime import UTC, date, datetime
from pathlib import Path

from labpipe.errors import ReadError
from labpipe.readers.channels import ChannelChoice
from labpipe.readers.controldesk import Axis, Export, Trace, load_export, resolve_date
from labpipe.readers.number_table import Body, read_columns
from labpipe.readers.raw_files import add_file_name, map_read_errors, read_content, read_head
from labpipe.records.arrays import Floats
from labpipe.records.recording import Recording
from labpipe.units import parse_count

_SAMPLES_MARK = b"\ntrace_values"
_NAMES_PROPERTY = "trace_names"
_TRACE_PROPERTIES = (
    *("devices", "raster", "description", "displayidentifier", "path", "flags"),
    *("min", "max", "minWeak", "maxWeak"),
)


def recognise(path: Path) -> bool:
    """Return whether a file is a ControlDesk CSV, by the first cell of one of its first lines."""
    lines = read_head(path).removeprefix(BOM_UTF8).splitlines()
    return any(line.startswith((b"descriptions,", b"trace_")) for line in lines)


def read(path: Path, *, channels: Sequence[ChannelChoice] | None = None) -> Recording:
    """Read a ControlDesk CSV file.

    Parameters
    ----------
    path : the export
    channels : names or paths of the wanted channels, None for all

    Returns
    -------
    The recording.

    Raises
    ------
    ReadError
        If a row of properties, the samples or a wanted channel is missing or damaged.
    """
    content = read_content(path).data
    header, mark, data = (b"\n" + content).partition(_SAMPLES_MARK)
    if not mark:
        line = content.count(b"\n") + 1
        raise ReadError.about("readers.no_trace_values", path, f"line {line}")
    with map_read_errors(path, "rows of properties"):
        text = header[1:].decode("utf-8", errors="replace")
        rows = list(csv.reader(io.StringIO(text, newline="")))
    properties = {row[0]: row[1:] for row in rows if row and row[0]}
    names = properties.get(_NAMES_PROPERTY, [])
    if not names:
        raise ReadError.about("readers.no_trace_names", path, f"lines 1 to {len(rows)}")
    body = Body(
        data=data,
        names=("", "time", *names[1:]),
        columns=range(1, len(names) + 1),
        first_line=header.count(b"\n") + 1,
        separator=",",
        decimal=".",
        stated_rows=parse_count("".join(properties.get("trace_size", [])[:1])),
        as_exported=True,
    )
    with add_file_name(path):
        samples, notes = read_columns(body)
    clock, *traces = [
        {key: cells[i] if i < len(cells) else "" for key, cells in properties.items()}
        for i in range(len(names))
    ]
    descriptions: dict[str, dict[str, str]] = {}
    for row in rows:
        if len(row) >= 4 and row[1] and row[0] in {"descriptions", ""}:
            descriptions.setdefault(row[1], {})[row[2]] = row[3]  # group, key and value
    general_group, measurement_group = (descriptions.get(x, {}) for x in ("General", "Measurement"))
    reference_date = _parse_reference_date(measurement_group.get("ReferenceTime", ""))
    recording_date = resolve_date(general_group.get("DateTime", ""), reference_date)
    export = Export(
        axes=[Axis(clock.get("raster", ""), clock.get("trace_units", ""), lambda: samples[1])],
        traces=[_make_trace(x, samples[i]) for i, x in enumerate(traces, start=2)],
        origin=general_group.get("Origin", ""),
        metadata={"date": recording_date, **descriptions},
        notes=notes,
    )
    return load_export(export, reader="dspace-csv", path=path, channels=channels)


def _make_trace(properties: Mapping[str, str], values: Floats) -> Trace:
    """Make a trace of its properties, keyed as in the file, and its samples."""
    name, folder = properties[_NAMES_PROPERTY], properties.get("path", "")
    return Trace(
        name=name,
        path=f"{folder}/{name}" if folder else name,
        unit_in_file=properties.get("trace_units", ""),
        axis_index=0,
        load=lambda: values,
        properties={key: properties[key] for key in _TRACE_PROPERTIES if key in properties},
    )


def _parse_reference_date(nanoseconds: str) -> date | None:
    """Parse the date of ReferenceTime, ns since 1970 UTC; None if the text is not a time."""
    max_digits = 19  # of times before the year 2287
    seconds = parse_count(nanoseconds[:-9])
    if seconds is None or len(nanoseconds) > max_digits:
        return None
    return datetime.fromtimestamp(seconds, tz=UTC).date()
