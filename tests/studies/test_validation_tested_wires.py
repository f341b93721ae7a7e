"""Which wires are tested, and what is said of those that are not as they should be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.errors import ProcessingError, UsageError
from labpipe.protocol.plans import CalibrationPlan
from labpipe.studies.first_loadings import FirstLoading
from labpipe.studies.validation import (
    built_wire,
    require_known,
    usual_sheet,
    wire_to_calibrate,
    without_copies,
)
from tests.builders.loading_tests import measured
from tests.builders.wire_tables import wire_table

SHEET = Path("wires.xlsx")


def loadings(*names: str) -> list[FirstLoading]:
    return [FirstLoading(curve, 0.0, ()) for name in names for curve in measured(name, samples=1)]


def asked(wire: str | None = None) -> CalibrationPlan:
    return CalibrationPlan(version=1, wire=wire)


def test_the_sheet_of_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=r"expected a wire sheet, or wires.xlsx or wires.csv in"):
        usual_sheet()
    (tmp_path / "wires.csv").touch()
    assert usual_sheet() == Path("wires.csv")


def test_the_only_wire_or_the_one_of_the_plan() -> None:
    assert wire_to_calibrate(loadings("A2"), asked(), None) == "A2"
    assert wire_to_calibrate(loadings("A2", "A1"), asked("A1"), None) == "A1"
    with pytest.raises(UsageError, match="expected tests of one wire, found tests of 2 wires"):
        wire_to_calibrate(loadings("A2", "A1"), asked(), None)
    with pytest.raises(UsageError, match="expected tests of 'A3', found usable tests of A2 alone"):
        wire_to_calibrate(loadings("A2"), asked("A3"), None)


def test_wires_of_tests_are_in_the_sheet() -> None:
    spec = wire_table("A2").spec
    require_known(loadings("A2"), {"A2": spec}, SHEET)
    with pytest.raises(UsageError, match="expected a row for 'A1', the specimen type of test A1"):
        require_known(loadings("A1"), {"A2": spec}, SHEET)


def test_a_wire_that_cannot_be_built() -> None:
    spec = wire_table("A2").spec
    assert len(built_wire(spec, SHEET).section.layers) == 2
    thin = replace(spec, wire_diameter=0.5 * spec.wire_diameter)
    with pytest.raises(ProcessingError, match="expected a wire that can be built, found this: "):
        built_wire(thin, SHEET)


def test_a_copy_of_a_test_does_not_count() -> None:
    own, other = loadings("A2", "A1")
    one, two = replace(own, file=Path("x/T1/result.h5")), replace(own, file=Path("y/T1/result.h5"))
    kept, left_out = without_copies([one, other, two])
    assert kept == [one, other]
    assert left_out == {
        str(two.file): f"{two.file}: expected each test once, found the same first loading as in "
        f"{one.file}. Leave the copy away."
    }
