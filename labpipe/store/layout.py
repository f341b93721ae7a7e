"""Derive the datasets, attributes and tables of a result file from the types of its records.

The type hint of a field defines how the field is stored. An array annotated with axes and a `Unit`
becomes a dataset of numbers. A tuple of strings with an axis becomes a dataset of strings. Any
other number, string, interval or reason becomes an attribute. A tuple of records becomes a table.
Fields with ``compare=False`` are not stored.

Every dataset has the attributes ``unit`` and ``axes``. Each axis has a dimension scale in the same
group, as netCDF-4 requires. A table is a group with one dataset per column, not an HDF5 compound,
because Octave skips compound types, and strings in them crash the netCDF library. Strings are
UTF-8. They have a variable length in attributes. In datasets they have a fixed length and are
declared as ASCII, because Octave reads only this type, and HDF5 has no checksums for variable
lengths.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from datetime import date
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Final, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from labpipe.records.arrays import Unit, get_number_type
from labpipe.records.curve import Branch, FittedLine, Interval, Slip
from labpipe.records.quality import QualityNote, Reason
from labpipe.records.result import Instrument

_R = TypeVar("_R")

SCHEMA: Final = 2
"""Version of the layout. Files of other versions cannot be read."""
SCHEMA_ATTRIBUTE: Final = "labpipe_schema"
"""Name of the attribute of a file that states its version."""

UNSTATED_UNIT: Final = "unknown"
"""Unit of channels for which neither the export nor the protocol states one."""

TEXT: Final = "text"
"""Unit and type of a dataset of strings."""

# Names of groups and datasets that several modules use.
SPECIMEN: Final = "specimen"
RAW: Final = "raw"
TIME: Final = "time"
ALIGNED: Final = "aligned"
EVENTS: Final = "events"
CURVE: Final = "curve"
BRANCHES: Final = "branches"
SLIPS: Final = "slips"
LINES: Final = "lines"
SHAPE: Final = "shape"
BENDING: Final = "bending"
LAW: Final = "law"
RESULTS: Final = "results"
BUDGETS: Final = "budgets"
QUALITY: Final = "quality"
INSTRUMENTS: Final = "instruments"


@dataclass(frozen=True, slots=True)
class DatasetSpec:
    """Definition of a dataset.

    Parameters
    ----------
    axes : names of the axes
    unit : SI unit; None if the unit is stated when a dataset is written
    dtype : NumPy name of the number type; ``text`` for strings
    stated_in : name of the field of the record that states the unit; empty if no field does
    """

    axes: tuple[str, ...]
    unit: str | None
    dtype: str = "float64"
    stated_in: str = ""


class AttributeSpec(NamedTuple):
    """Definition of a field that is stored as an attribute or as a cell of a table.

    Parameters
    ----------
    kind : type of the field, without None
    unit : unit of a number; None if the type hint states no unit
    is_optional : whether the field may be None
    """

    kind: Any
    unit: Unit | None
    is_optional: bool


class ColumnSpec(NamedTuple):
    """Definition of a column of a table of records.

    Parameters
    ----------
    name : name of the field of the record
    bound : bound of the interval in the field, ``lower`` or ``upper``; empty for any other field
    dataset : definition of the dataset of the column
    """

    name: str
    bound: str
    dataset: DatasetSpec


def _cached(function: Callable[[Any], _R]) -> Callable[[Any], _R]:
    """Cache a function whose argument is a type, for which mypy rejects `functools.cache`."""
    return cache(function)


@_cached
def list_datasets(record_type: Any) -> Mapping[str, DatasetSpec]:
    """List the definitions of the datasets of a type of record, keyed by name."""
    datasets: dict[str, DatasetSpec] = {}
    for name, (field_type, axes, unit) in _list_annotations(record_type):
        if get_origin(field_type) is np.ndarray:
            dtype = np.dtype(get_number_type(field_type)).name.replace("bool", "uint8")
            symbol, stated_in = (unit.symbol or None, unit.stated_in) if unit else (None, "")
            datasets[name] = DatasetSpec(axes, symbol, dtype, stated_in)
        elif get_origin(field_type) is tuple and axes:
            datasets[name] = DatasetSpec(axes, TEXT, TEXT)
    return datasets


def choose_scales(datasets: Mapping[str, DatasetSpec]) -> dict[str, str]:
    """Choose the first one-dimensional dataset of each axis as its dimension scale.

    Parameters
    ----------
    datasets : definitions of the datasets of a group, keyed by name

    Returns
    -------
    Name of the scale, keyed by axis.
    """
    one_axis_datasets = [(name, spec) for name, spec in datasets.items() if len(spec.axes) == 1]
    return {spec.axes[0]: name for name, spec in reversed(one_axis_datasets)}


@_cached
def list_attributes(record_type: Any) -> Mapping[str, AttributeSpec]:
    """List the fields of a type of record that are stored as attributes, keyed by name.

    They are the numbers, strings, dates, intervals and reasons.
    """
    stored_names = {field.name for field in fields(record_type) if field.compare}
    stored_names -= {spec.stated_in for spec in list_datasets(record_type).values()}
    attributes: dict[str, AttributeSpec] = {}
    for name, (field_type, axes, unit) in _list_annotations(record_type):
        kinds = get_args(field_type) if isinstance(field_type, UnionType) else (field_type,)
        kind = next(kind for kind in kinds if kind is not NoneType)
        is_simple = isinstance(kind, type) and issubclass(
            kind, (int, float, str, date, Interval, Reason)
        )
        is_list = get_origin(kind) is tuple and get_args(kind)[0] in (str, Reason) and not axes
        if name in stored_names and (is_simple or is_list):
            attributes[name] = AttributeSpec(kind, unit, NoneType in kinds)
    return attributes


@_cached
def list_columns(row_type: Any) -> Mapping[str, ColumnSpec]:
    """List the columns of a table, keyed by name.

    Parameters
    ----------
    row_type : type of the records, a key of `ROW_AXES`
    """
    number_dtypes = {int: "int64", float: "float64", bool: "uint8", Interval: "float64"}
    columns: dict[str, ColumnSpec] = {}
    for name, (kind, unit, _) in list_attributes(row_type).items():
        dtype = number_dtypes.get(kind, TEXT)
        symbol = TEXT if dtype == TEXT else (unit.symbol or None) if unit else "1"
        dataset = DatasetSpec((ROW_AXES[row_type],), symbol, dtype)
        if kind is Interval:
            columns |= {
                make_bound_prefix(name) + bound: ColumnSpec(name, bound, dataset)
                for bound in ("lower", "upper")
            }
        else:
            columns[name] = ColumnSpec(name, "", dataset)
    return columns


def make_bound_prefix(interval_name: str) -> str:
    """Make the prefix of the columns of both bounds, such as ``drop_`` for ``drop_interval``."""
    return interval_name.removesuffix("interval")


def _list_annotations(
    record_type: Any,
) -> Iterator[tuple[str, tuple[Any, tuple[str, ...], Unit | None]]]:
    """Yield name, type, axes and unit of the fields of a type of record."""
    for name, hint in get_type_hints(record_type, include_extras=True).items():
        field_type, *annotations = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        axes = tuple(annotation for annotation in annotations if isinstance(annotation, str))
        units = (annotation for annotation in annotations if isinstance(annotation, Unit))
        yield name, (field_type, axes, next(units, None))


@dataclass(frozen=True, slots=True)
class ResultRow:
    """A result as a row of ``results/table``, for programs that do not read attributes."""

    name: str
    value: Annotated[float | None, Unit("of the result")]
    estimate: Annotated[float | None, Unit("of the result")]
    lower: Annotated[float, Unit("of the result")]
    upper: Annotated[float, Unit("of the result")]
    unit: str
    level: float
    status: str
    code: str
    reason: str


@dataclass(frozen=True, slots=True)
class BudgetRow:
    """A contribution to the uncertainty of a result, as a row of ``budgets``."""

    result: str
    cause: str
    change: Annotated[float, Unit("of the result")]
    unit: str
    share: float
    is_common: bool


ROW_AXES: Final[Mapping[type, str]] = {
    Branch: "branch",
    Slip: "slip",
    FittedLine: "line",
    Instrument: "instrument",
    QualityNote: "note",
    ResultRow: "result",
    BudgetRow: "contribution",
}
"""Axis of the table for each type of record that is stored as a row."""


def make_link_name(name: str, used_names: Iterable[str]) -> str:
    """Make an unused name of a group or dataset that HDF5, h5dump and MATLAB accept.

    Parameters
    ----------
    name : name, such as that of a channel; characters other than letters, digits and ``_.+-``
        become underscores
    used_names : names in use in the same group

    Returns
    -------
    The name, with a number appended if it is in use.

    Examples
    --------
    >>> make_link_name("Load Cell/Out1", {"Load_Cell_Out1"})
    'Load_Cell_Out1_2'
    """
    valid_name = re.sub(r"[^\w.+-]", "_", name)
    valid_name = valid_name if valid_name.strip("._") else "unnamed"
    used_names = set(used_names)
    numbered_names = (f"{valid_name}_{number}" for number in range(2, len(used_names) + 3))
    return next(name for name in (valid_name, *numbered_names) if name not in used_names)
