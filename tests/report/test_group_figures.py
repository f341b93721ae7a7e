from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from labpipe.report.group_figures import drawings, stems
from labpipe.report.saving import FORMATS, save_report_figures
from tests.builders.campaigns import build_group, build_sample, six_samples


def test_figures_that_a_group_has_data_for() -> None:
    full = build_group("A", six_samples())
    assert [each.name for each in drawings(full)] == [
        "curves", "scaled", "slips", "lines", "numbers",
    ]  # fmt: skip
    bare = [replace(build_sample("s1", "a"), lines=())]
    assert [each.name for each in drawings(build_group("A", bare, scaled=False))] == ["curves"]
    assert [each.name for each in drawings(build_group("A", []))] == ["curves"]


def test_every_figure_can_be_told_without_being_seen() -> None:
    told = {each.name: each for each in drawings(build_group("A", six_samples()))}
    assert told["curves"].alt == (
        "Force against displacement: A, 6 samples from 2 spools."
        " The mean reaches 134 N; it is known up to 40 mm."
    )
    assert "the mean of 6 samples" in told["curves"].caption
    assert told["slips"].alt == "Slips of tt-s1b, tt-s2b on their curves."
    assert told["lines"].alt == (
        "Fitted lines on the curves of A: Stiffness, first region; Stiffness, second region."
    )
    lone = next(drawings(build_group("A", [build_sample("s1", "a")])))
    assert "There is no band; the figure says why." in lone.caption


def test_saved_in_each_format_with_the_same_bytes(tmp_path: Path) -> None:
    sample = replace(build_sample("s1", "a"), lines=())
    group = build_group("A", [sample], scaled=False)
    runs = []
    for name in "ab":
        folder = tmp_path / name
        folder.mkdir()
        runs.append(save_report_figures(drawings(group), folder, formats=FORMATS))
    files = runs[0][0].files
    assert [path.name for path in files] == ["curves.svg", "curves.png", "curves.pdf"]
    for one, other in zip(files, runs[1][0].files, strict=True):
        assert one.read_bytes() == other.read_bytes()
    assert files[1].read_bytes().startswith(b"\x89PNG")
    assert files[2].read_bytes().startswith(b"%PDF")


def test_letters_are_lines_so_that_no_font_of_a_reader_changes_them(tmp_path: Path) -> None:
    group = build_group("A", [build_sample("s1", "a")])
    (curves, *_) = save_report_figures(drawings(group), tmp_path)
    drawn = curves.files[0].read_text(encoding="utf-8")
    assert "<text" not in drawn
    assert "Displacement (mm)" in drawn  # a comment, to be found by searches
    assert "<dc:title>Force against displacement: A, 1 sample from 1 spool." in drawn


def test_names_with_signs_of_mathematics_are_drawn_as_they_are(tmp_path: Path) -> None:
    sample = replace(build_sample("$x_$", "a"), test="$\\frac{$")
    (saved, *_) = save_report_figures(drawings(build_group("_A$_{$", [sample])), tmp_path)
    assert "_A$_{$" in saved.files[0].read_text(encoding="utf-8")


def test_file_names() -> None:
    assert stems(["A2 85 mm", "a2/85/mm", "\u00b5"]) == ["a2-85-mm", "a2-85-mm-2", "group"]
    assert stems(["A" * 200])[0] == "a" * 60


def test_the_caption_says_where_the_band_of_the_whole_curve_leaves_the_panel() -> None:
    group = build_group("A", six_samples(), scaled=False)
    caption = next(iter(drawings(group))).caption
    assert "leave the panel" not in caption
    half = np.linspace(0.0, 90.0, len(group.band.mean))
    wide = replace(group.band, lower_all=group.band.mean - half, upper_all=group.band.mean + half)
    caption = next(iter(drawings(replace(group, band=wide)))).caption
    assert (
        "They leave the panel, as 6 curves say little about a whole one: at 40 mm, where they are"
        " furthest apart, they are at "
    ) in caption
    assert caption.count(" N.") == 1
