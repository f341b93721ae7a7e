from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import get_args
from xml.etree import ElementTree

import pytest

from labpipe.errors import StoreError
from labpipe.protocol.schema import FigureName
from labpipe.records.result import TestResult
from labpipe.report.figures import FIGURES, save_figures
from tests.store.builders_result import build_result


@pytest.fixture(scope="module")
def result() -> TestResult:
    return build_result(half_cycle=1.0)


@pytest.mark.slow
def test_all_figures_in_both_formats_with_the_same_bytes(
    result: TestResult, tmp_path: Path
) -> None:
    every = replace(result, figures=tuple(FIGURES))
    one, other = (save_figures(every, tmp_path / name, png=True) for name in "ab")
    assert [path.name for path in one] == [
        f"{name}.{kind}" for name in FIGURES for kind in ("svg", "png")
    ]
    for first, second in zip(one, other, strict=True):
        assert first.read_bytes() == second.read_bytes()
    assert b"<dc:date>" not in one[0].read_bytes()
    for path in one[1::2]:
        content = path.read_bytes()
        assert content.startswith(b"\x89PNG")
        # 180 mm at 300 dots per inch
        assert int.from_bytes(content[16:20]) == int(180 / 25.4 * 300)


def test_every_figure_that_a_protocol_may_ask_for_can_be_drawn() -> None:
    assert set(get_args(FigureName)) == set(FIGURES)


def test_only_what_the_protocol_asks_for(result: TestResult, tmp_path: Path) -> None:
    paths = save_figures(replace(result, figures=("timeline",)), tmp_path)
    assert list(tmp_path.iterdir()) == paths
    assert [path.name for path in paths] == ["timeline.svg"]


def test_unknown_figure(result: TestResult, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"figures=\['pie'\]: expected some of \['force-disp"):
        save_figures(replace(result, figures=("pie", "timeline")), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_folder_that_cannot_be_made(result: TestResult, tmp_path: Path) -> None:
    (tmp_path / "x").write_text("")
    with pytest.raises(StoreError, match=r"expected a folder that figures can be written to, foun"):
        save_figures(result, tmp_path / "x")


def test_drawing_program_is_loaded_only_when_a_figure_is_drawn() -> None:
    code = (
        "import sys, labpipe.report.figures; "
        "sys.exit(any(name.split('.')[0] in {'matplotlib', 'pint'} for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["$\\frac{$", "A\x07\n\ud8002", "x" * 300, "<b>&\U0001f600"])
def test_any_name_is_drawn(result: TestResult, tmp_path: Path, name: str) -> None:
    specimen = replace(result.specimen, type=name, spool=name, sample=name)
    notes = tuple(replace(note, where=name, message=name) for note in result.quality)
    odd = replace(result, test=name, specimen=specimen, quality=notes, figures=tuple(FIGURES))
    for drawn in save_figures(odd, tmp_path):
        ElementTree.fromstring(drawn.read_bytes())
