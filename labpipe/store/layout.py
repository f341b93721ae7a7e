"""Names, units and axes of everything in a result file: the schema, as data.

Every dataset has the attributes ``unit`` and ``axes``; a unit of None here means that the dataset
defines its own. Each axis has a dimension scale, as netCDF-4 requires: a dataset of its group. A
table is a group of columns, never a compound: Octave skips compounds, and texts in them crash the
netCDF library. Texts are UTF-8: of variable length in attributes, of fixed length in datasets,
where they are declared ASCII. Octave reads only this type of text, and checksums cover it; HDF5 has
none for variable lengths.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

SCHEMA: Final = 2
"""Version of the layout; other versions are refused."""

NO_UNIT: Final = "unknown"
"""Unit of channels for which neither the export nor the protocol states one."""

TEXT: Final = "text"
"""The unit of a dataset of strings."""


@dataclass(frozen=True, slots=True)
class Field:
    """Definition of a dataset.

    Parameters
    ----------
    axes : names of the axes
    unit : SI unit; None if the dataset defines its own
    dtype : numpy's name of the number type
    """

    axes: tuple[str, ...]
    unit: str | None
    dtype: str = "float64"


@dataclass(frozen=True, slots=True)
class Table:
    """A group of columns of one length.

    Parameters
    ----------
    axis : name of the one axis
    scale : column that is its dimension scale
    columns : unit and number type, by name
    """

    axis: str
    scale: str
    columns: Mapping[str, Field]


def _table(axis: str, scale: str, columns: Mapping[str, tuple[str | None, str]]) -> Table:
    return Table(axis, scale, {name: Field((axis,), *kind) for name, kind in columns.items()})


_TEXTS: Final = (TEXT, "text")

COORDINATES: Final[Mapping[str, tuple[str, ...]]] = {
    "xyz": ("x", "y", "z"),
    "xyzw": ("x", "y", "z", "w"),
    "xy": ("x", "y"),
    "specimen": ("x", "y", "z"),
    "lab": ("x", "y", "z"),
}
"""Labels along an axis without its own dataset; other axes are numbered from 0."""

# Attributes of the root, each also a field of TestResult.
SCHEMA_ATTRIBUTE: Final = "labpipe_schema"
ROOT_TEXTS: Final = ("test", "labpipe_version", "protocol", "protocol_yaml", "test_yaml")
SPECIMEN_TEXTS: Final = {"type": "specimen_type", "spool": "spool", "sample": "sample"}
RUN: Final = "run"
DISPLAY: Final = "display"
FIGURES: Final = "figures"
DATE: Final = "date"
OPERATOR: Final = "operator"
INSTRUMENTS: Final = "instruments"
"""Group of columns, only if the protocol has certificates."""
INSTRUMENT_TABLE: Final = _table(
    "instrument",
    "channel",
    {
        "channel": _TEXTS,
        "measures": _TEXTS,
        "certificate": _TEXTS,
        "calibrated": _TEXTS,
        "due": _TEXTS,
        "uncertainty": ("1", "float64"),
        "k": ("1", "float64"),
    },
)

SPECIMEN: Final = "specimen"
"""Group whose attributes are the dimensions: names, values, and their one unit."""
LABELS: Final = "labels"
LABEL_WORDS: Final = "label_words"
BUNDLE: Final = "bundle"
"""Group in `SPECIMEN`, for a harness bundle only."""
BUNDLE_TEXTS: Final = ("arrangement", "tape", "taping", "conduit")
BORE: Final = "conduit_bore"
WIRE_TYPES: Final = "wire_types"
WIRE_NUMBERS: Final = "wire_numbers"
WIRE_NUMBER: Final = Field(("type",), "1", "int64")
WIRE_DIAMETERS: Final = "wire_diameters"
WIRE_DIAMETER: Final = Field(("type",), "m")
POSITIONS: Final = "positions"
WIRE_POSITION: Final = Field(("wire", "xy"), "m")
BUNDLE_SCALES: Final = {"type": WIRE_TYPES}

# /raw/<role>
RAW: Final = "raw"
RECORDING_TEXTS: Final = ("reader", "program", "program_version")
INPUT_ORDER: Final = "input_order"
METADATA: Final = "metadata"
NOTES: Final = "notes"
TIME: Final = "time"
CLOCK_TIME: Final = Field(("sample",), None)
CHANNEL: Final = Field(("sample",), None)
CHANNEL_TEXTS: Final = {
    "name": "name",
    "path": "name_in_file",
    "clock": "clock",
    "unit_in_file": "unit_in_file",
    "calibration": "calibration",
}
MARKERS: Final = "markers"
NAMES: Final = "names"
MARKER_FIELDS: Final[Mapping[str, Field]] = {
    "time": Field(("frame",), "s"),
    "frames": Field(("frame",), "1"),
    "positions": Field(("frame", "marker", "xyz"), "m"),
}
MARKER_SCALES: Final = {"frame": TIME, "marker": NAMES}
BODIES: Final = "rigid_bodies"
BODY_FIELDS: Final[Mapping[str, Field]] = {
    "position": Field(("frame", "xyz"), "m"),
    "rotation": Field(("frame", "xyzw"), "1"),
    "error": Field(("frame",), "m"),
}
BODY_SCALES: Final = {"frame": TIME}

# /aligned
ALIGNED: Final = "aligned"
SERIES: Final = Field(("sample",), None)
EVENTS: Final = "events"
EVENT_FIELDS: Final[Mapping[str, Field]] = {
    "event_times_motion": Field(("event",), "s"),
    "event_times_force": Field(("event",), "s"),
    "event_errors": Field(("event",), "s"),
}
EVENT_SCALES: Final = {"event": "event_times_motion"}
CLOCK_FIT_UNITS: Final = {"offset": "s", "drift": "1", "residual": "s"}
CLOCK_FIT_INTERVALS: Final = ("offset", "drift")

# /curve
CURVE: Final = "curve"
CURVE_FIELDS: Final[Mapping[str, Field]] = {
    "displacement": Field(("sample",), "m"),
    "force": Field(("sample",), "N"),
    "branch": Field(("sample",), "1", "int64"),
    "cycle": Field(("sample",), "1", "int64"),
}
SAMPLE_SCALES: Final = {"sample": TIME}
"""Of the groups `ALIGNED` and `CURVE`."""
BRANCHES: Final = "branches"
BRANCH_TABLE: Final = _table(
    "branch",
    "start",
    {
        "start": ("sample", "int64"),
        "stop": ("sample", "int64"),
        "cycle": ("1", "int64"),
        "direction": _TEXTS,
        "start_time": (None, "float64"),
        "stop_time": (None, "float64"),
    },
)
"""Its times are in the unit of the curve's clock."""

SLIPS: Final = "slips"
SLIP_TABLE: Final = _table(
    "slip",
    "position",
    {
        "position": ("m", "float64"),
        "drop": ("N", "float64"),
        "position_lower": ("m", "float64"),
        "position_upper": ("m", "float64"),
        "drop_lower": ("N", "float64"),
        "drop_upper": ("N", "float64"),
        "decision": _TEXTS,
        "start": ("sample", "int64"),
        "stop": ("sample", "int64"),
    },
)

LINES: Final = "lines"
LINE_TABLE: Final = _table(
    "line",
    "result",
    {
        "result": _TEXTS,
        "slope": ("N/m", "float64"),
        "level": ("N", "float64"),
        "start": ("m", "float64"),
        "stop": ("m", "float64"),
    },
)

# /shape
SHAPE: Final = "shape"
SHAPE_FIELDS: Final[Mapping[str, Field]] = {
    "time": Field(("frame",), "s"),
    "positions": Field(("frame", "point", "xyz"), "m"),
    "flags": Field(("frame", "point"), "1", "uint8"),
    "arc_length": Field(("point",), "m"),
    "coefficients": Field(("frame", "xyz", "term"), "m"),
    "rotation_lab_to_specimen": Field(("specimen", "lab"), "1"),
}
SHAPE_SCALES: Final = {"frame": TIME, "point": NAMES}

# /bending and /bending/law
BENDING: Final = "bending"
CLOUD_FIELDS: Final[Mapping[str, Field]] = {
    "time": Field(("mean",), "s"),
    "branch": Field(("mean",), "1", "int64"),
    "cycle": Field(("mean",), "1", "int64"),
    "force": Field(("mean",), "N"),
    "arc_length": Field(("place",), "m"),
    "curvature": Field(("mean", "place"), "1/m"),
    "curvature_error": Field(("mean", "place"), "1/m"),
    "curvature_systematic": Field(("mean", "place"), "1/m"),
    "moment": Field(("mean", "place"), "N*m"),
    "moment_error": Field(("mean", "place"), "N*m"),
    "moment_at_rest": Field(("place",), "N*m"),
}
CLOUD_SCALES: Final = {"mean": TIME, "place": "arc_length"}
LAW: Final = "law"
LAW_FIELDS: Final[Mapping[str, Field]] = {
    "curvature": Field(("point",), "1/m"),
    "moment": Field(("point",), "N*m"),
    "moment_lower": Field(("point",), "N*m"),
    "moment_upper": Field(("point",), "N*m"),
    "secant": Field(("point",), "N*m^2"),
    "secant_lower": Field(("point",), "N*m^2"),
    "secant_upper": Field(("point",), "N*m^2"),
    "tangent": Field(("point",), "N*m^2"),
    "tangent_lower": Field(("point",), "N*m^2"),
    "tangent_upper": Field(("point",), "N*m^2"),
    "knots": Field(("knot",), "N*m"),
    "compliance": Field(("knot",), "1/(N*m^2)"),
    "compliance_covariance": Field(("knot", "knot"), "1/(N*m^2)^2"),
}
LAW_SCALES: Final = {"point": "curvature", "knot": "knots"}
IS_KNOWN: Final = "is_known"
KNOWN: Final = Field(("point",), "1", "uint8")
LAW_UNITS: Final = {"floor": "1/m", "scale_error": "1", "residual": "m", "noise": "m"}

# /results/<name>, /budgets and /quality
RESULTS: Final = "results"
RESULT_TEXTS: Final = ("unit", "status", "method", "made_of", "remark", "seal")
ESTIMATE: Final = "estimate"
REASON_CODES: Final = "reason_codes"
REASON_MESSAGES: Final = "reason_messages"
INTERVAL_NUMBERS: Final = ("lower", "upper", "level")
RESULT_TABLE: Final = "table"
"""Group in `RESULTS` with a row per result, for programs that do not read attributes."""
RESULT_COLUMNS: Final = _table(
    "result",
    "name",
    {
        "name": _TEXTS,
        "value": ("of the result", "float64"),
        "estimate": ("of the result", "float64"),
        "lower": ("of the result", "float64"),
        "upper": ("of the result", "float64"),
        "unit": _TEXTS,
        "level": ("1", "float64"),
        "status": _TEXTS,
        "code": _TEXTS,
        "reason": _TEXTS,
    },
)
BUDGETS: Final = "budgets"
"""One table for all results: those of a test have about five rows each."""
BUDGET_TABLE: Final = _table(
    "contribution",
    "result",
    {
        "result": _TEXTS,
        "cause": _TEXTS,
        "change": ("of the result", "float64"),
        "unit": _TEXTS,
        "share": ("1", "float64"),
        "is_common": ("1", "uint8"),
    },
)
QUALITY: Final = "quality"
NOTE_COLUMNS: Final = ("code", "severity", "where", "message")
NOTE_TABLE: Final = _table("note", "code", dict.fromkeys(NOTE_COLUMNS, _TEXTS))


def link_name(name: str, taken: Iterable[str]) -> str:
    """Return an unused name that HDF5, h5dump and MATLAB accept.

    Parameters
    ----------
    name : such as that of a channel; slashes, blanks and other characters become underscores
    taken : names in use in the same group

    Returns
    -------
    The name, with a number appended if it is in use.

    Examples
    --------
    >>> link_name("Load Cell/Out1", {"Load_Cell_Out1"})
    'Load_Cell_Out1_2'
    """
    plain = re.sub(r"[^\w.+-]", "_", name)
    plain = plain if plain.strip("._") else "unnamed"
    used = set(taken)
    numbered = (f"{plain}_{number}" for number in range(2, len(used) + 3))
    return next(free for free in (plain, *numbered) if free not in used)
