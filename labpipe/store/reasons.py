"""Reasons as attributes of a group, codes and sentences in two lists: both ways."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, Final

from labpipe.records.quality import Reason
from labpipe.store import layout
from labpipe.store.checked import text, texts
from labpipe.store.chunks import Target

_OF_ONE_WORD: Final = "cut|drift|gap|saturation|truncated"
_NEXT: Final = re.compile(rf"; (?=(?:[a-z0-9]+(?:_[a-z0-9]+)+|{_OF_ONE_WORD}): )")
"""Where the next reason begins in the text of schema 1: a code and a colon."""


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
        return upgraded(text(group, "reason"))
    codes, messages = (texts(group, name) for name in (layout.REASON_CODES, layout.REASON_MESSAGES))
    return tuple(Reason(*each) for each in zip(codes, messages, strict=True))


def upgraded(glued: str) -> tuple[Reason, ...]:
    """Take the reasons of schema 1 apart, where they are one text; empty where there are none.

    Examples
    --------
    >>> upgraded("drift: the zero drifts; at last; gap: 4 samples are missing")[1]
    Reason(code='gap', message='4 samples are missing')
    """
    parted = (each.partition(": ") for each in _NEXT.split(glued) if each)
    return tuple(Reason(code, message) for code, _, message in parted)
