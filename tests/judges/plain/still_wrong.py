"""Cases that labpipe still gets wrong, and what is wrong in one line. The table is to be empty."""

from __future__ import annotations

import pytest

STILL_WRONG: dict[str, str] = {}


def marked(name: str) -> list[pytest.MarkDecorator]:
    """The mark of a case of the table: it must fail, and by the judge."""
    if name not in STILL_WRONG:
        return []
    return [pytest.mark.xfail(strict=True, raises=AssertionError, reason=STILL_WRONG[name])]
