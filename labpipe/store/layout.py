"""Define names, units and axes of all content of a result file, derived from the records.

The annotations of a record define its part of the file: an array with axes and `Unit` is a dataset,
an annotated tuple of texts one of strings, any other number, text, interval or reason an attribute;
a tuple of records is a table. Fields that do not count in a comparison are not stored.

Every dataset has the attributes ``unit`` and ``axes``. Each axis has a dimension scale, as netCDF-4
requires: a dataset of its group. A table is a group of columns, never a compound: Octave skips
compounds, and texts in them crash the netCDF library. Texts are UTF-8: of variable length in
attributes, of fixed length in datasets, where they are declared ASCII. Octave reads only this type
of text, and checksums cover it; HDF5 has none for variable lengths.
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

from labpipe.records.arrays import Unit, find_dtype
from labpipe.records.curve import Branch, FittedLine, Interval, Slip
from labpipe.records.quality import QualityNote, Reason
from labpipe.records.result import Instrument

_R = TypeVar("_R")

SCHEMA: Final = 2
"""Version of the layout; other versions are refused."""
SCHEMA_ATTRIBUTE: Final = "labpipe_schema"

UNSTATED_UNIT: Final = "unknown"
"""Unit of channels for which neither the export nor the protocol states one."""

TEXT: Final = "text"
"""The unit of a dataset of strings."""

# Groups and datasets that several modules name.
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
    unit : SI unit; None if the dataset defines its own
    dtype : numpy's name of the number type; ``text`` for strings
    stated_in : field of the record that states the unit; empty for none
    """

    axes: tuple[str, ...]
    unit: str | None
    dtype: str = "float64"
    stated_in: str = ""


class AttributeSpec(NamedTuple):
    """A field of a record that is an attribute, or a cell of a table.

    Parameters
    ----------
    kind : type of the field, without None
    unit : of a number; None if its annotation states none
    is_optional : whether it may be None
    """

    kind: Any
    unit: Unit | None
    is_optional: bool


class ColumnSpec(NamedTuple):
    """A column of a table of records.

    Parameters
    ----------
    name : field of the record
    end : of an interval in that field; empty for any other field
    field : definition of the dataset
    """

    name: str
    end: str
    field: DatasetSpec


def _cached(function: Callable[[Any], _R]) -> Callable[[Any], _R]:
    """Cache a function of a type; mypy does not accept types as keys of `functools.cache`."""
    return cache(function)


@_cached
def list_datasets(record: Any) -> Mapping[str, DatasetSpec]:
    """Return the datasets of a type of record, by name."""
    datasets: dict[str, DatasetSpec] = {}
    for name, (values, axes, unit) in _list_annotations(record):
        if get_origin(values) is np.ndarray:
            dtype = np.dtype(find_dtype(values)).name.replace("bool", "uint8")
            symbol, stated_in = (unit.symbol or None, unit.stated_in) if unit else (None, "")
            datasets[name] = DatasetSpec(axes, symbol, dtype, stated_in)
        elif get_origin(values) is tuple and axes:
            datasets[name] = DatasetSpec(axes, TEXT, TEXT)
    return datasets


def find_scales(datasets: Mapping[str, DatasetSpec]) -> dict[str, str]:
    """Return the dimension scale of each axis: the first dataset with no other axis."""
    one_axis_datasets = [(name, field) for name, field in datasets.items() if len(field.axes) == 1]
    return {field.axes[0]: name for name, field in reversed(one_axis_datasets)}


@_cached
def list_attributes(record: Any) -> Mapping[str, AttributeSpec]:
    """Return the fields of a type of record that are numbers, texts, intervals or reasons."""
    stored_names = {field.name for field in fields(record) if field.compare}
    stored_names -= {field.stated_in for field in list_datasets(record).values()}
    attributes: dict[str, AttributeSpec] = {}
    for name, (hint, axes, unit) in _list_annotations(record):
        kinds = get_args(hint) if isinstance(hint, UnionType) else (hint,)
        kind = next(kind for kind in kinds if kind is not NoneType)
        is_simple = isinstance(kind, type) and issubclass(
            kind, (int, float, str, date, Interval, Reason)
        )
        is_list = get_origin(kind) is tuple and get_args(kind)[0] in (str, Reason) and not axes
        if name in stored_names and (is_simple or is_list):
            attributes[name] = AttributeSpec(kind, unit, NoneType in kinds)
    return attributes


@_cached
def list_columns(row: Any) -> Mapping[str, ColumnSpec]:
    """Return the columns of a table, by name.

    Parameters
    ----------
    row : type of record, a key of `ROW_AXES`
    """
    number_types = {int: "int64", float: "float64", bool: "uint8", Interval: "float64"}
    columns: dict[str, ColumnSpec] = {}
    for name, (kind, unit, _) in list_attributes(row).items():
        dtype = number_types.get(kind, TEXT)
        symbol = TEXT if dtype == TEXT else (unit.symbol or None) if unit else "1"
        field = DatasetSpec((ROW_AXES[row],), symbol, dtype)
        if kind is Interval:
            columns |= {
                find_stem(name) + end: ColumnSpec(name, end, field) for end in ("lower", "upper")
            }
        else:
            columns[name] = ColumnSpec(name, "", field)
    return columns


def find_stem(interval: str) -> str:
    """Return the start of the names of an interval's ends: ``drop_`` for ``drop_interval``."""
    return interval.removesuffix("interval")


def _list_annotations(
    record: Any,
) -> Iterator[tuple[str, tuple[Any, tuple[str, ...], Unit | None]]]:
    """Yield name, type, axes and unit of the fields of a type of record."""
    for name, hint in get_type_hints(record, include_extras=True).items():
        value, *annotations = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        axes = tuple(annotation for annotation in annotations if isinstance(annotation, str))
        yield (
            name,
            (
                value,
                axes,
                next(
                    (annotation for annotation in annotations if isinstance(annotation, Unit)), None
                ),
            ),
        )


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
    """A contribution as a row of ``budgets``; one table for all results of a test."""

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
"""Types of records that are rows of a table, and the axis of the table."""


def make_link_name(name: str, used_names: Iterable[str]) -> str:
    """Return an unused name that HDF5, h5dump and MATLAB accept.

    Parameters
    ----------
    name : such as that of a channel; slashes, blanks and other characters become underscores
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
    names = set(used_names)
    numbered = (f"{valid_name}_{number}" for number in range(2, len(names) + 3))
    return next(candidate for candidate in (valid_name, *numbered) if candidate not in names)
