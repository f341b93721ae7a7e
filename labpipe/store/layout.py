"""Names, units and axes of everything in a result file: the schema, as data.

Every dataset carries the attributes ``unit`` and ``axes``; a unit of None here means that the
dataset says its own. Strings are UTF-8: of variable length in attributes, of fixed length in
datasets, so that the checksum covers them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

SCHEMA: Final = 2
"""Version of the layout; 1 is read, too, and a file with a higher one is refused."""

NO_UNIT: Final = "unknown"
"""Stands where neither the export nor the protocol has said the unit."""

TEXT: Final = "text"
"""The unit of a dataset of strings."""


@dataclass(frozen=True, slots=True)
class Field:
    """What one dataset must be.

    Parameters
    ----------
    axes : name of each axis
    unit : SI unit; None where the dataset says its own
    dtype : numpy's name of the number type
    """

    axes: tuple[str, ...]
    unit: str | None
    dtype: str = "float64"


# Attributes of the root, each also a field of TestResult.
SCHEMA_ATTRIBUTE: Final = "labpipe_schema"
ROOT_TEXTS: Final = ("test", "labpipe_version", "protocol", "protocol_yaml", "test_yaml")
SPECIMEN_TEXTS: Final = {"type": "specimen_type", "spool": "spool", "sample": "sample"}
RUN: Final = "run"
DISPLAY: Final = "display"
FIGURES: Final = "figures"

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
BODIES: Final = "rigid_bodies"
BODY_FIELDS: Final[Mapping[str, Field]] = {
    "position": Field(("frame", "xyz"), "m"),
    "rotation": Field(("frame", "xyzw"), "1"),
    "error": Field(("frame",), "m"),
}

# /aligned
ALIGNED: Final = "aligned"
SERIES: Final = Field(("sample",), None)
EVENTS: Final = "events"
EVENT_FIELDS: Final[Mapping[str, Field]] = {
    "event_times_motion": Field(("event",), "s"),
    "event_times_force": Field(("event",), "s"),
    "event_errors": Field(("event",), "s"),
}
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
BRANCHES: Final = "branches"
BRANCH_COLUMNS: Final = (
    ("start", "int64"),
    ("stop", "int64"),
    ("cycle", "int64"),
    ("direction", "S16"),
    ("start_time", "float64"),
    ("stop_time", "float64"),
)


def branch_table(time_unit: str) -> Field:
    """Say what the table of branches must be: its times are in the unit of the curve's clock."""
    return Field(("branch",), f"sample, sample, 1, text, {time_unit}, {time_unit}", "table")


SLIPS: Final = "slips"
SLIP_TABLE: Final = Field(("slip",), "m, N, m, m, N, N, text, sample, sample", "table")
SLIP_COLUMNS: Final = (
    ("position", "float64"),
    ("drop", "float64"),
    ("position_lower", "float64"),
    ("position_upper", "float64"),
    ("drop_lower", "float64"),
    ("drop_upper", "float64"),
    ("decision", "S16"),
    ("start", "int64"),
    ("stop", "int64"),
)

LINES: Final = "lines"
LINE_TABLE: Final = Field(("line",), "text, N/m, N, m, m", "table")
LINE_COLUMNS: Final = (
    ("result", "S64"),
    ("slope", "float64"),
    ("level", "float64"),
    ("start", "float64"),
    ("stop", "float64"),
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
IS_KNOWN: Final = "is_known"
KNOWN: Final = Field(("point",), "1", "uint8")
LAW_UNITS: Final = {"floor": "1/m", "scale_error": "1", "residual": "m", "noise": "m"}

# /results/<name>, /budgets and /quality
RESULTS: Final = "results"
RESULT_TEXTS: Final = ("unit", "status", "method", "made_of", "remark")
ESTIMATE: Final = "estimate"
REASON_CODES: Final = "reason_codes"
REASON_MESSAGES: Final = "reason_messages"
INTERVAL_NUMBERS: Final = ("lower", "upper", "level")
BUDGETS: Final = "budgets"
"""One table for all results: those of a test have about five rows each."""
BUDGET_TABLE: Final = Field(("contribution",), "text, text, of the result, text, 1, 1", "table")
BUDGET_COLUMNS: Final = (
    ("result", "S64"),
    ("cause", "S64"),
    ("change", "float64"),
    ("unit", "S16"),
    ("share", "float64"),
    ("is_common", "uint8"),
)
QUALITY: Final = "quality"
NOTE_COLUMNS: Final = ("code", "severity", "where", "message")


def link_name(name: str, taken: Iterable[str]) -> str:
    """Turn any name into one that HDF5, h5dump and MATLAB take, and that is still free.

    Parameters
    ----------
    name : such as a channel's; slashes, blanks and other signs become underscores
    taken : names that are in use in the same group

    Returns
    -------
    The name, with a number behind it if it was taken.

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
