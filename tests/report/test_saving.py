from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from labpipe.report.page import style, titled_page
from labpipe.report.saving import PNG_DPI, save_page


def page() -> Figure:
    figure = titled_page("title", "", width_mm=25.4, height_mm=25.4)
    figure.subplots().plot([0.0, 1.0])
    return figure


def test_one_page_in_two_formats_with_the_same_bytes(tmp_path: Path) -> None:
    with style(), ThreadPoolExecutor(max_workers=1) as packer:
        one, other = (save_page(page(), tmp_path, name, packer) for name in ("a.b", "c"))
    assert [path.name for path in one.files] == ["a.b.svg", "a.b.png"]
    for first, second in zip(one.files, other.files, strict=True):
        assert first.read_bytes() == second.read_bytes()
    svg, png = (path.read_bytes() for path in one.files)
    assert b"<dc:date>" not in svg
    assert int.from_bytes(png[16:20]) == PNG_DPI
    assert one.packing.result() is None


def test_what_goes_wrong_is_raised(tmp_path: Path) -> None:
    with (
        style(),
        ThreadPoolExecutor(max_workers=1) as packer,
        pytest.raises(FileNotFoundError),
    ):
        save_page(page(), tmp_path / "missing", "a", packer)
    (tmp_path / "a.png").mkdir()
    with style(), ThreadPoolExecutor(max_workers=1) as packer:
        saved = save_page(page(), tmp_path, "a", packer)
    with pytest.raises(IsADirectoryError):
        saved.packing.result()
