from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from labpipe.report.figure_page import style, titled_page
from labpipe.report.saving import PNG_DPI, FigureToSave, save_page, save_pages, save_report_figures


def page() -> Figure:
    figure = titled_page("title", "", width_mm=25.4, height_mm=25.4)
    figure.subplots().plot([0.0, 1.0])
    return figure


def test_one_page_in_two_formats_with_the_same_bytes(tmp_path: Path) -> None:
    with style(), ThreadPoolExecutor(max_workers=1) as packer:
        one, other = (save_page(page(), tmp_path, name, packer).whole() for name in ("a.b", "c"))
    assert [path.name for path in one] == ["a.b.svg", "a.b.png"]
    for first, second in zip(one, other, strict=True):
        assert first.read_bytes() == second.read_bytes()
    svg, png = (path.read_bytes() for path in one)
    assert b"<dc:date>" not in svg
    assert int.from_bytes(png[16:20]) == PNG_DPI


def test_the_svg_does_not_depend_on_the_png(tmp_path: Path) -> None:
    wanted = [FigureToSave("a", page)]
    both = save_pages(wanted, tmp_path / "both", what="figures", again="draw", png=True)
    (alone,) = save_pages(wanted, tmp_path / "alone", what="figures", again="draw")
    assert [path.name for path in both] == ["a.svg", "a.png"]
    assert alone.read_bytes() == both[0].read_bytes()
    assert list((tmp_path / "alone").iterdir()) == [alone]


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
        saved.whole()


def test_each_figure_of_a_report_says_what_it_is(tmp_path: Path) -> None:
    wanted = [FigureToSave("one", page, "How to\x07 read it.", "One & two")]
    (one,) = save_report_figures(wanted, tmp_path, formats=("svg",))
    assert [file.name for file in one.files] == ["one.svg"]
    drawn = one.files[0].read_text(encoding="utf-8")
    assert "<dc:title>One &amp; two</dc:title>" in drawn
    assert "<dc:description>How to\ufffd read it.</dc:description>" in drawn


def test_png_and_pdf_on_request(tmp_path: Path) -> None:
    wanted = [FigureToSave("one", page)]
    for formats in (("svg",), ("svg", "pdf"), ("png",)):
        (tmp_path / "-".join(formats)).mkdir()
        (one,) = save_report_figures(wanted, tmp_path / "-".join(formats), formats=formats)
        endings = {file.suffix[1:] for file in one.files}
        assert endings == {"svg", *formats}
        assert {file.suffix[1:] for file in one.files[0].parent.iterdir()} == endings


def test_nothing_to_save(tmp_path: Path) -> None:
    assert save_report_figures([], tmp_path) == []


def test_words_are_as_wide_in_pixels_as_in_an_svg() -> None:
    """Else they would leave the room that they were given, or the page."""
    with style():
        widths = []
        for canvas in (FigureCanvasAgg, FigureCanvasSVG):
            figure = Figure(dpi=200)
            canvas(figure)
            words = figure.text(0.0, 0.5, "mean of taping none, wire B1 & B2, number 19", size=7)
            widths.append(words.get_window_extent().width / figure.dpi)
    assert widths[0] == pytest.approx(widths[1], rel=3e-3)
