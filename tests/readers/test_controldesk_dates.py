from __future__ import annotations

from datetime import date

import pytest

from labpipe.readers.controldesk import day_of_saving, written_date


@pytest.mark.parametrize(
    ("text", "near", "iso"),
    [
        ("10/31/2015 17:42:35", date(2015, 10, 31), "2015-10-31"),
        ("4-5-2023 17:30:33", date(2023, 5, 4), "2023-05-04"),
        ("2021/01/03 15:54:55", date(2021, 1, 3), "2021-01-03"),
        ("5/1/2026 9:35:51 PM", date(2026, 5, 1), "2026-05-01"),
        ("12/01/2026 11:00:26 a. m.", date(2026, 1, 12), "2026-01-12"),
        ("12/01/2026 11:00:26 a. m.", date(2026, 6, 1), ""),
        ("12/01/2026", None, ""),
        ("yesterday", date(2026, 6, 1), ""),
        ("99/99/2026", date(2026, 6, 1), ""),
        ("1/1/99999999999999999999", date(2026, 6, 1), ""),
        (f"1/{'9' * 5000}/2026", date(2026, 6, 1), ""),
    ],
)
def test_the_day_of_saving_settles_the_order(text: str, near: date | None, iso: str) -> None:
    assert written_date(text, near) == iso


def test_the_day_in_a_mat_header() -> None:
    header = "MATLAB 5.0 MAT-file, Platform: PCWIN, Created on: {} 17:31:15 2023"
    assert day_of_saving(header.format("Thu May 04")) == date(2023, 5, 4)
    assert day_of_saving(header.format("Fri May  5")) == date(2023, 5, 5)
    assert day_of_saving(header.format("Fri May 45")) is None
    assert day_of_saving(header.format("Don Mai 04")) is None
    assert day_of_saving(header.format(f"Thu May {'9' * 5000}")) is None
    assert day_of_saving("") is None
