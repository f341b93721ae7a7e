from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.errors import StoreError
from labpipe.report.calibration_figures import calibration_drawings, save_calibration_figures
from labpipe.report.calibration_shown import CalibrationReport
from tests.report.builders_calibrations import group, report, shapes, usual


def test_names_of_figures() -> None:
    names = [drawing.name for drawing in calibration_drawings(report())]
    assert names == ["calibration", "validation-1", "shapes-1"]
    many = replace(report(), groups=(group(),) * 7, shapes={"a": (), "b": ()})
    names = [drawing.name for drawing in calibration_drawings(many)]
    assert names == ["calibration", "validation-1", "validation-2", "shapes-1", "shapes-2"]
    assert [each.name for each in calibration_drawings(CalibrationReport(usual()))] == names[:1]


@pytest.mark.slow
def test_all_figures(tmp_path: Path) -> None:
    told: list[str] = []
    calibration = replace(usual(), wire="$A_2$ <&>")
    own = replace(report(), calibration=calibration, groups=(group(),), shapes=shapes())
    files = save_calibration_figures(own, tmp_path / "figures", say=told.append)
    assert sorted(files) == sorted((tmp_path / "figures").iterdir())
    assert [path.name for path in files[:2]] == ["calibration.svg", "validation-1.svg"]
    assert told == [path.stem for path in files]
    again = save_calibration_figures(own, tmp_path / "again")
    for first, second in zip(files, again, strict=True):
        assert first.read_bytes() == second.read_bytes()
        assert first.stat().st_size < 1_500_000


def test_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("")
    with pytest.raises(
        StoreError,
        match=r"x: expected a folder that figures of a calibration can be written to, found ",
    ):
        save_calibration_figures(report(), tmp_path / "x")


def test_drawing_program_is_loaded_only_when_a_figure_is_drawn() -> None:
    code = (
        "import sys, labpipe.report.calibration_figures, labpipe.report.calibration_workbook; "
        "sys.exit(any(name.split('.')[0] in {'matplotlib', 'openpyxl'} for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
