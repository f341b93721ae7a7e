"""Reasons as attributes of a group, codes and sentences in two lists: both ways."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from labpipe.records.quality import Reason
from labpipe.store import layout
from labpipe.store.datasets import Target, text, texts
from labpipe.store.schema_1 import reasons_in


def write_reasons(target: Target, reasons: Iterable[Reason]) -> None:
    """Write reasons.

    Parameters
    ----------
    target : group of what they are the reasons of
    reasons : any number
    """
    told = tuple(reasons)
    target.texts(layout.REASON_CODES, tuple(each.code for each in told))
    target.texts(layout.REASON_MESSAGES, tuple(each.message for each in told))


def read_reasons(group: Any) -> tuple[Reason, ...]:
    """Read reasons.

    Parameters
    ----------
    group : open HDF5 group that `write_reasons` wrote to, or one of schema 1
    """
    if layout.REASON_CODES not in group.attrs:
        return reasons_in(text(group, "reason"))
    codes, messages = (texts(group, name) for name in (layout.REASON_CODES, layout.REASON_MESSAGES))
    return tuple(Reason(*each) for each in zip(codes, messages, strict=True))
