from __future__ import annotations

import pytest

from labpipe.records.quality import Reason, worded
from labpipe.store.stored_parts import method_parts, reasons_in


def test_reasons_are_taken_apart_where_the_next_code_is() -> None:
    reasons = (
        Reason("frozen_channel", "the force stands still; for 3 s: from 1 s; is it connected?"),
        Reason("gap", "4 samples are missing"),
    )
    assert reasons_in(worded(reasons)) == reasons
    assert reasons_in("") == ()


@pytest.mark.parametrize(
    ("method", "parts"),
    [
        ("by a line", ("by a line", "", "")),
        ("stiffness / peak force", ("stiffness / peak force", "stiffness", "")),
        (
            "largest force; 3 N of slips added back",
            ("largest force", "", "3 N of slips added back"),
        ),
    ],
)
def test_what_a_method_says_beside(method: str, parts: tuple[str, str, str]) -> None:
    found = method_parts(method, ["stiffness", "energy.1"])
    assert (found["method"], found["made_of"], found["remark"]) == parts
