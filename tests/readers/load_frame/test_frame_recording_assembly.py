from __future__ import annotations

import numpy as np
import pytest

from labpipe.readers.load_frame.cards import shipped_cards
from labpipe.readers.load_frame.frame_recording import Export, Table, assemble

N = 12
COUNT = np.arange(float(N))


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("s", 1.0), ("Sec", 1.0), ("SEC", 1.0), ("min", 60.0), ("ms", 1e-3), ("d", 86400.0)],
)
def test_time_is_in_seconds(unit: str, factor: float) -> None:
    table = Table("", ("Time", "F"), (unit, "N"), {0: COUNT, 1: COUNT})
    recording = assemble(Export((table,)), shipped_cards()["nexygen"], "a")
    np.testing.assert_allclose(recording.clocks[0].time, factor * COUNT)
    assert recording.metadata["clocks"] == {"time": {"time": "Time", "unit_in_file": unit}}


def test_notes_on_channels() -> None:
    names, units = ("Time", "F", "F", "still"), ("s", "N", "", "mm")
    gone = np.where(COUNT == 3, np.nan, COUNT)
    table = Table("", names, units, {0: COUNT, 1: COUNT, 2: gone, 3: 0.0 * COUNT})
    recording = assemble(Export((table,)), shipped_cards()["nexygen"], "a")
    assert [(note.code, note.where, note.message) for note in recording.notes] == [
        ("missing_values", "F [2]", "1 of 12 values are missing, the first in row 4"),
        ("constant_channel", "channels", "1 of 3 channels never change: 'still'"),
        ("units_not_stated", "channels", "no unit is stated for 1 of 3 channels: 'F [2]'"),
        ("names_not_unique", "channels", "of 3 channels 2 are called 'F': tell them apart by path"),
    ]
