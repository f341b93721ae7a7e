from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import pytest

from labpipe.records.quality import Reason
from labpipe.store.datasets import Target
from labpipe.store.stored_parts import read_reasons, write_reasons


@pytest.mark.parametrize(
    "reasons", [(), (Reason("drift", "the zero drifts; it does"), Reason("gap", "é: 4 samples"))]
)
def test_what_is_written_is_read(tmp_path: Path, reasons: tuple[Reason, ...]) -> None:
    with ThreadPoolExecutor(1) as pool, h5py.File(tmp_path / "r.h5", "w") as root:
        write_reasons(Target(root, pool), reasons)
        assert read_reasons(root) == reasons


def test_reasons_of_schema_1_are_one_text(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "r.h5", "w") as root:
        root.attrs["reason"] = "gap: 4 samples are missing"
        assert read_reasons(root) == (Reason("gap", "4 samples are missing"),)
