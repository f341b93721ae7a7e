from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from labpipe.report.saved_figures import FigureToSave, save_figures


def line() -> Figure:
    page = Figure(figsize=(2, 1))
    page.subplots().plot([0, 1], [0, 1])
    return page


def test_each_figure_is_saved_three_times(tmp_path: Path) -> None:
    wanted = [FigureToSave(name, line, f"How to read {name}.", name) for name in ("one", "two")]
    one, two = save_figures(wanted, tmp_path)
    assert [file.name for file in one.files] == ["one.svg", "one.png", "one.pdf"]
    assert all(file.stat().st_size for file in (*one.files, *two.files))
    assert one.caption == "How to read one."
    assert 'aria-label="two"' in two.drawing.element
    (again,) = save_figures([wanted[0]._replace(name="again")], tmp_path)
    assert [file.read_bytes() for file in again.files[1:]] == [
        file.read_bytes() for file in one.files[1:]
    ]


def test_nothing_to_save(tmp_path: Path) -> None:
    assert save_figures([], tmp_path) == []
