"""Result files of schema 1: what has fields of its own since was part of their texts."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Final

from labpipe.records.quality import Reason

_OF_ONE_WORD: Final = "cut|drift|gap|saturation|truncated"
_NEXT: Final = re.compile(rf"; (?=(?:[a-z0-9]+(?:_[a-z0-9]+)+|{_OF_ONE_WORD}): )")
"""Where the next reason begins: a code and a colon."""
_REMARK: Final = re.compile(r"(.*); ([^;]* of slips added back)")


def reasons_in(glued: str) -> tuple[Reason, ...]:
    """Take the text of all reasons apart; empty where there are none.

    Examples
    --------
    >>> reasons_in("drift: the zero drifts; at last; gap: 4 samples are missing")[1]
    Reason(code='gap', message='4 samples are missing')
    """
    parted = (each.partition(": ") for each in _NEXT.split(glued) if each)
    return tuple(Reason(code, message) for code, _, message in parted)


def method_parts(method: str, results: Collection[str]) -> dict[str, str]:
    """Find what a method says of the test alone, and the result that a number is made of.

    Parameters
    ----------
    method : of a result
    results : names of the other results of the test

    Examples
    --------
    >>> method_parts("stiffness x length; 3 N of slips added back", ["stiffness"])
    {'method': 'stiffness x length', 'made_of': 'stiffness', 'remark': '3 N of slips added back'}
    """
    found = _REMARK.fullmatch(method)
    plain, remark = found.groups() if found else (method, "")
    made_of = next((word for word in re.findall(r"[\w.]+", plain) if word in results), "")
    return {"method": plain, "made_of": made_of, "remark": remark}
