"""Records of studies as lists and numbers for JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from labpipe.store.summaries import replace_non_finite


def plain(value: Any) -> Any:
    """Convert records, arrays and numbers for JSON; None for a number that is not finite."""
    if isinstance(value, float):
        return replace_non_finite(value)
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if is_dataclass(value):
        return entries(value, *(item.name for item in fields(value)))
    return str(value) if isinstance(value, StrEnum) else value


def entries(record: object, *names: str, **renamed: str) -> dict[str, Any]:
    """Return attributes of a record for JSON, see `to_json`.

    Parameters
    ----------
    record : any
    names : of attributes
    renamed : entry=attribute
    """
    attributes = {name: name for name in names} | renamed
    return {entry: plain(getattr(record, name)) for entry, name in attributes.items()}
