"""Derive the datasets, attributes and tables of a result file from the types of its records.

The type hint of a field defines how the field is stored. An array annotated with axes and a `Unit`
becomes a dataset of numbers. A tuple of strings with an axis becomes a dataset of strings. Any
other number, string, date, interval or reason becomes an attribute, and so does a tuple of strings
or reasons without an axis. A tuple of records becomes a table. Attributes and cells of tables of
fields with ``compare=False`` are not stored.

Every dataset has the attributes ``unit`` and ``axes``. Each axis has a dimension scale in the same
group, as netCDF-4 requires. A table is a group with one dataset per column, not an HDF5 compound,
because Octave skips compound types, and strings in them crash the netCDF library. Strings are
encoded in UTF-8. Attributes have strings of variable length. Datasets have strings of fixed length,
because HDF5 has no checksums for strings of variable length; their type is declared as ASCII,
because Octave reads no other type.
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

SCHEMA_VERSION: Final = 2
"""Version of the layout. Files of other versions cannot be read."""
SCHEMA_ATTRIBUTE: Final = "labpipe_schema"
"""Name of the attribute of a file that contains the version of its layout."""

UNSTATED_UNIT: Final = "unknown"
"""Unit of channels for which neither the export nor the protocol states one."""

TEXT: Final = "text"
"""Unit and type of a dataset of strings."""


@dataclass(frozen=True, slots=True)
class DatasetSpec:
    """Definition of a dataset.

    Parameters
    ----------
    axes : names of the axes
    unit : SI unit; None if the unit is stored with each dataset
    dtype : NumPy name of the number type; ``text`` for strings
    unit_field : name of the field of the record that contains the unit; empty if no field does
    """

    axes: tuple[str, ...]
    unit: str | None
    dtype: str = "float64"
    unit_field: str = ""


_ATTRIBUTE_TYPES: Final = (int, float, str, date, Interval, Reason)
"""Types of the values, or of the items of tuples, that are stored as attributes."""


class AttributeSpec(NamedTuple):
    """Definition of a field that is stored as an attribute or as a cell of a table.

    Parameters
    ----------
    field_type : type of the field, without None
    unit : unit of a number; None if the type hint states no unit
    is_optional : whether the field may be None
    """

    field_type: Any
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


def _cache_by_type(function: Callable[[Any], _R]) -> Callable[[Any], _R]:
    """Cache a function whose argument is a type, for which mypy rejects `functools.cache`."""
    return cache(function)


@_cache_by_type
def list_datasets(record_type: Any) -> Mapping[str, DatasetSpec]:
    """List the definitions of the datasets of a type of record, keyed by name."""
    datasets: dict[str, DatasetSpec] = {}
    for name, (field_type, axes, unit) in _list_annotations(record_type):
        if get_origin(field_type) is np.ndarray:
            dtype = np.dtype(get_number_type(field_type)).name
            dtype = "uint8" if dtype == "bool" else dtype  # netCDF-4 has no type for booleans
            symbol, unit_field = (unit.symbol, unit.unit_field) if unit else ("", "")
            datasets[name] = DatasetSpec(axes, symbol or None, dtype, unit_field)
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


@_cache_by_type
def list_attributes(record_type: Any) -> Mapping[str, AttributeSpec]:
    """List the fields of a type of record that are stored as attributes, keyed by name.

    They are the numbers, strings, dates, intervals and reasons, and the tuples of strings or
    reasons without an axis. Fields with ``compare=False``, and fields that contain the unit of an
    array, are excluded.
    """
    stored_names = {field.name for field in fields(record_type) if field.compare}
    stored_names -= {spec.unit_field for spec in list_datasets(record_type).values()}
    attributes: dict[str, AttributeSpec] = {}
    for name, (field_type, axes, unit) in _list_annotations(record_type):
        union_members = get_args(field_type) if isinstance(field_type, UnionType) else (field_type,)
        stored_type = next(member for member in union_members if member is not NoneType)
        is_tuple = get_origin(stored_type) is tuple and not axes
        item_type = get_args(stored_type)[0] if is_tuple else stored_type
        is_attribute = isinstance(item_type, type) and issubclass(item_type, _ATTRIBUTE_TYPES)
        if is_attribute and name in stored_names:
            attributes[name] = AttributeSpec(stored_type, unit, NoneType in union_members)
    return attributes


@_cache_by_type
def list_columns(row_type: Any) -> Mapping[str, ColumnSpec]:
    """List the columns of a table, keyed by name.

    Parameters
    ----------
    row_type : type of the records, a key of `ROW_AXES`
    """
    number_dtypes = {int: "int64", float: "float64", bool: "uint8", Interval: "float64"}
    columns: dict[str, ColumnSpec] = {}
    for name, (field_type, unit, _) in list_attributes(row_type).items():
        dtype = number_dtypes.get(field_type, TEXT)
        symbol = TEXT if dtype == TEXT else (unit.symbol or None) if unit else "1"
        dataset = DatasetSpec((ROW_AXES[row_type],), symbol, dtype)
        if field_type is Interval:
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
    """A result as a row of a table, for programs that do not read attributes, and for catalogs.

    Parameters
    ----------
    name, value, unit, status : fields of the `Result`; the value is None for a failed result
    estimate : best estimate, equal to the value if noise does not change it
    lower, upper, level : ends and level of the interval; None or NaN without one
    code : codes of the reasons, separated by commas
    reason : reasons as text
    """

    name: str
    value: Annotated[float | None, Unit("of the result")]
    estimate: Annotated[float | None, Unit("of the result")]
    lower: Annotated[float | None, Unit("of the result")]
    upper: Annotated[float | None, Unit("of the result")]
    unit: str
    level: float | None
    status: str
    code: str
    reason: str


@dataclass(frozen=True, slots=True)
class BudgetRow:
    """A contribution to the uncertainty of a result, as a row of ``budgets``.

    Parameters
    ----------
    result, unit : name and unit of the result
    cause, change, is_common : fields of the `Contribution`
    share : fraction of the variance of the result
    """

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
"""Name of the axis of the rows of a table, keyed by type of record."""


def make_link_name(name: str, used_names: Iterable[str]) -> str:
    """Make an unused name of a group or dataset that HDF5, h5dump and MATLAB accept.

    Parameters
    ----------
    name : preferred name, such as that of a channel
    used_names : names in use in the same group

    Returns
    -------
    The name, in which characters other than letters, digits and ``_.+-`` are replaced by
    underscores; ``unnamed`` if only underscores and dots are left. A number is appended to a name
    that is in use.

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
