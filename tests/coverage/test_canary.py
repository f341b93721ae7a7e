"""Whether the code gives the kept numbers again: the studies hold while it does."""

from __future__ import annotations

import os
from datetime import UTC, datetime

import numpy as np
import pytest

from tests.coverage.study import (
    STUDIES,
    Study,
    canary,
    describe_changes,
    kept_rows,
    kinds_of,
    make_row,
    remedy,
)

QUICK = {"tests": 2, "push": 1, "own A2 85 mm 2 mN": 1}
"""Rows of each kind that `make test` makes again, within 40 s of CPU: all canaries of calibrations
and lines would take 150, and are left to `make test-slow`."""
SHARE = 0.05


@pytest.mark.parametrize(
    ("kind", "number"), [(kind, n) for name, n in QUICK.items() for kind in kinds_of([name])]
)
def test_canary_rows_are_made_again(kind: str, number: int) -> None:
    wanted = canary([kind])[:number]
    assert len(wanted) == number
    changed = describe_changes(make_row(*each) for each in wanted)
    assert not changed, remedy(changed)


@pytest.mark.slow
@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.name)
def test_rows_drawn_by_the_date_are_made_again(study: Study) -> None:
    """All canaries, and a share of all rows; STUDY_SEED draws them of another date again."""
    seed = int(os.environ.get("STUDY_SEED") or f"{datetime.now(UTC):%Y%m%d}")
    rows = [
        (kind, number) for kind, own in kept_rows().items() if kind in study.seeds for number in own
    ]
    drawn = np.random.default_rng(seed).choice(len(rows), round(SHARE * len(rows)), replace=False)
    wanted = dict.fromkeys([*canary(study.seeds), *(rows[number] for number in sorted(drawn))])
    changed = describe_changes(make_row(*each) for each in wanted)
    print(f"STUDY_SEED={seed}: {len(wanted)} of {len(rows)} {study.name}")  # noqa: T201
    assert not changed, f"STUDY_SEED={seed}\n{remedy(changed)}"
