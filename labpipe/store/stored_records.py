"""Write and read records of a result file, as `layout` derives them from their annotations."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import date
from math import isnan, nan
from typing import Any, TypeVar

import numpy as np

from labpipe.records.curve import Interval
from labpipe.records.quality import Reason
from labpipe.store.datasets import (
    Target,
    has_attribute,
    read_array,
    read_number,
    read_text,
    read_texts,
    set_number,
    set_text,
    set_texts,
)
from labpipe.store.layout import (
    TEXT,
    AttributeSpec,
    list_attributes,
    list_columns,
    list_datasets,
    make_bound_prefix,
)

_R = TypeVar("_R")
_ENDS = ("lower", "upper", "level")
_REASONS = Reason, tuple[Reason, ...]
_CODES, _MESSAGES = "reason_codes", "reason_messages"


def write_record(target: Target, record: object) -> None:
    """Write the arrays and attributes of a record.

    Parameters
    ----------
    target : its group
    record : of a type whose annotations define the layout
    """
    write_arrays(target, record)
    write_attributes(target, record)


def read_record(group: Any, kind: type[_R], **extra: object) -> _R:
    """Read a record that `write_record` wrote.

    Parameters
    ----------
    group : of the record
    kind : its type
    extra : values of fields that are stored elsewhere
    """
    return kind(**read_arrays(group, kind), **read_attributes(group, kind, skip=extra), **extra)


def write_arrays(target: Target, record: Any) -> None:
    """Write the arrays of a record as datasets with dimension scales.

    Parameters
    ----------
    target : its group
    record : of a type whose annotations define the layout
    """
    for name, spec in list_datasets(type(record)).items():
        values = getattr(record, name)
        if spec.dtype == "uint8":
            values = values.astype(np.uint8)
        target.write_array(name, values, spec, getattr(record, spec.stated_in, ""))
    target.attach_scales()


def read_arrays(group: Any, kind: Any, names: Iterable[str] = ()) -> dict[str, Any]:
    """Read the arrays of a record, by name, with the texts that state their units.

    Parameters
    ----------
    group : of the record
    kind : its type
    names : of the arrays; all if empty
    """
    arrays: dict[str, Any] = {}
    for name, spec in list_datasets(kind).items():
        if not names or name in names:
            arrays[name] = read_array(group, name, spec)
            if spec.stated_in:
                arrays[spec.stated_in] = read_text(group[name], "unit")
    return arrays


def write_attributes(target: Target, record: Any, *, skip: Container[str] = ()) -> None:
    """Write the numbers, texts, intervals and reasons of a record.

    A number or interval that is None is not written; a text or reason that is None is empty.

    Parameters
    ----------
    target : its group
    record : of a type whose annotations define the layout
    skip : names of fields that are stored elsewhere
    """
    for name, attribute in list_attributes(type(record)).items():
        if name not in skip:
            _write_attribute(target.group, name, attribute, getattr(record, name))


def _write_attribute(group: Any, name: str, attribute: AttributeSpec, value: Any) -> None:
    kind, unit, _ = attribute
    if kind in _REASONS:
        reasons = value if isinstance(value, tuple) else (value,) if value else ()
        set_texts(group, _CODES, [reason.code for reason in reasons])
        set_texts(group, _MESSAGES, [reason.message for reason in reasons])
    elif isinstance(value, Interval):
        for end in _ENDS:
            set_number(group, make_bound_prefix(name) + end, float(getattr(value, end)))
    elif isinstance(value, tuple):
        set_texts(group, name, value)
    elif kind not in (int, float, Interval):
        set_text(group, name, _format_cell(value))
    elif value is not None:
        set_number(group, name, kind(value))
        if unit is not None:
            set_text(group, f"{name}_unit", unit.symbol)


def read_attributes(group: Any, kind: Any, *, skip: Container[str] = ()) -> dict[str, Any]:
    """Read what `write_attributes` wrote, by name of the field.

    Parameters
    ----------
    group : of the record
    kind : its type
    skip : names of fields that are stored elsewhere
    """
    attributes = list_attributes(kind).items()
    return {
        name: _read_attribute(group, name, attribute)
        for name, attribute in attributes
        if name not in skip
    }


def _read_attribute(group: Any, name: str, attribute: AttributeSpec) -> Any:
    kind, _, is_optional = attribute
    if kind in _REASONS:
        pairs = zip(read_texts(group, _CODES), read_texts(group, _MESSAGES), strict=True)
        reasons = tuple(Reason(*pair) for pair in pairs)
        return next(iter(reasons), None) if kind is Reason else reasons
    if kind == tuple[str, ...]:
        return read_texts(group, name)
    if kind not in (int, float, Interval):
        return _parse_cell({name: read_text(group, name)}, name, attribute)
    names = [make_bound_prefix(name) + end for end in _ENDS] if kind is Interval else [name]
    if is_optional and not has_attribute(group, names[0]):
        return None
    return kind(*(read_number(group, number) for number in names))


def write_table(
    target: Target, name: str, kind: type[_R], rows: Sequence[_R], unit: str = ""
) -> None:
    """Write records as a group of columns.

    Parameters
    ----------
    target : group in which the table is made
    name : of the table
    kind : type of the records, a key of `layout.ROW_AXES`
    rows : any number
    unit : of the columns without a unit in the layout
    """
    table = target.open_group(name)
    for column, (source, end, spec) in list_columns(kind).items():
        cells = [getattr(row, source) for row in rows]
        if end:
            cells = [getattr(interval, end) for interval in cells]
        values: Any = tuple(map(_format_cell, cells))
        if spec.dtype != TEXT:
            values = np.array([nan if cell is None else cell for cell in cells], spec.dtype)
        table.write_array(column, values, spec, unit)
    table.attach_scales()


def _format_cell(value: Any) -> str:
    return ", ".join(value) if isinstance(value, tuple) else "" if value is None else str(value)


def read_table(parent: Any, name: str, kind: type[_R], unit: str | None = None) -> tuple[_R, ...]:
    """Read a table that `write_table` wrote.

    Parameters
    ----------
    parent, name, kind : as `write_table` takes them
    unit : of the columns without a unit in the layout; None for any

    Returns
    -------
    The records; intervals have a level of 0.95.
    """
    names = list_columns(kind)
    columns = read_columns(parent[name], kind, names, unit)
    rows = (dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True))
    fields = list_attributes(kind).items()
    return tuple(
        kind(**{field: _parse_cell(row, field, attribute) for field, attribute in fields})
        for row in rows
    )


def read_columns(
    table: Any, kind: type, names: Iterable[str], unit: str | None = None
) -> list[Sequence[Any]]:
    """Read columns of a table that `write_table` wrote.

    Parameters
    ----------
    table : group of the columns
    kind, unit : as for `read_table`
    names : of the columns
    """
    columns: list[Sequence[Any]] = []
    for name in names:
        spec = list_columns(kind)[name].dataset
        cells = read_array(table, name, spec if spec.unit else replace(spec, unit=unit))
        columns.append(cells if isinstance(cells, tuple) else cells.tolist())
    return columns


def _parse_cell(row: Mapping[str, Any], name: str, attribute: AttributeSpec) -> Any:
    """Return one field of a record from a row."""
    if attribute.kind is Interval:
        return Interval(*(row[make_bound_prefix(name) + end] for end in ("lower", "upper")))
    cell = row[name]
    if attribute.is_optional and (cell == "" or (attribute.kind is float and isnan(cell))):
        return None
    if attribute.kind is date:
        return date.fromisoformat(cell)
    return tuple(cell.split(", ")) if attribute.kind == tuple[str, ...] else attribute.kind(cell)
