from __future__ import annotations

import pytest

from labpipe.records.causes import contribution
from labpipe.records.result import Contribution


@pytest.mark.parametrize(
    ("cause", "is_common"),
    [
        ("noise", False),
        ("scale of the force", True),
        ("compliance of the frame", True),
        ("pull offset", False),
        ("grip offset", True),
        ("span", True),
    ],
)
def test_what_tests_of_a_rig_share(cause: str, is_common: bool) -> None:
    assert contribution(cause, -0.2) == Contribution(cause, -0.2, is_common)


def test_a_cause_that_nobody_has_placed() -> None:
    with pytest.raises(KeyError):
        contribution("the moon", 0.1)
