"""Curves from elsewhere in a calibration plan: the grammar, and what is wrong with it in words."""

from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.load import load_calibration_plan
from labpipe.protocol.plans import CalibrationPlan

USUAL = {
    "name": "finite elements",
    "file": "fe.csv",
    "wire": "A2",
    "length": "85 mm",
    "because": "a model of solid elements",
}


def plan_of(folder: Path, *comparisons: dict[str, str]) -> Path:
    path = folder / "plan.yaml"
    lines = [
        f"  - {{{', '.join(f'{key}: {value}' for key, value in each.items())}}}"
        for each in comparisons
    ]
    path.write_text("\n".join(["version: 1", "comparisons:", *lines, ""]), encoding="utf-8")
    return path


def read(folder: Path, *comparisons: dict[str, str]) -> CalibrationPlan:
    return load_calibration_plan(plan_of(folder, *comparisons))


def told(folder: Path, *comparisons: dict[str, str]) -> str:
    with pytest.raises(ProtocolError) as caught:
        read(folder, *comparisons)
    return str(caught.value).replace(str(folder / "plan.yaml"), "plan")


def test_what_is_not_said(tmp_path: Path) -> None:
    (found,) = read(tmp_path, USUAL).comparisons
    assert (found.name, found.file, found.wire) == ("finite elements", "fe.csv", "A2")
    assert found.length == pytest.approx(0.085)
    assert found.load == "as tested"
    for column in (found.deflection, found.force):
        assert (column.column, column.unit, column.sign) == (None, None, 1)


def test_columns_units_and_signs(tmp_path: Path) -> None:
    columns = {
        "deflection": "{column: U2, unit: mm, sign: -1}",
        "force": "{column: 3, unit: mN, sign: +1}",
        "load": "normal",
        "file": "sub/fe.csv",
    }
    (found,) = read(tmp_path, USUAL | columns).comparisons
    across, up = found.deflection, found.force
    assert (across.column, across.unit, across.sign) == ("U2", "mm", -1)
    assert (up.column, up.unit, up.sign) == ("3", "mN", 1)
    assert (found.load, found.file) == ("normal", "sub/fe.csv")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"file": "../fe.csv"}, "expected a file inside the folder of the plan, found '../fe.csv'"),
        ({"file": "/fe.csv"}, "found '/fe.csv'. Copy the curve into the folder of the plan and"),
        ({"file": "C:\\fe.csv"}, "expected a file inside the folder of the plan"),
        ({"file": "' '"}, "expected the name of a file, found ' '"),
        ({"length": "85"}, "expected a quantity with a unit such as mm, found '85'"),
        ({"load": "upward"}, "expected one of 'as tested', 'normal', found 'upward'"),
        ({"deflection": "{unit: N}"}, "deflection.unit): expected a unit such as mm, found 'N'"),
        ({"force": "{unit: mm}"}, "force.unit): expected a unit such as N, found 'mm'"),
        ({"force": "{sign: 2}"}, "force.sign): expected 1 or -1, found '2'"),
        ({"force": "{colum: 2}"}, "found 'colum'. Did you mean 'column'?"),
        ({"because": "''"}, "expected text"),
    ],
)
def test_a_comparison_that_cannot_be(tmp_path: Path, change: dict[str, str], said: str) -> None:
    message = told(tmp_path, USUAL | change)
    assert message.startswith("plan, line 3")
    assert said in message


@pytest.mark.parametrize("key", list(USUAL))
def test_what_must_be_said(tmp_path: Path, key: str) -> None:
    message = told(tmp_path, {name: value for name, value in USUAL.items() if name != key})
    assert f"expected the key '{key}', found no such key. Add the key '{key}'." in message


def test_names_are_their_own(tmp_path: Path) -> None:
    assert told(tmp_path, USUAL, USUAL | {"name": "paper"}, USUAL) == (
        "plan, line 5, column 12 (comparisons.2.name): expected a name of its own, found 'finite "
        "elements', as comparison 1. Call it something else."
    )


def test_what_is_no_list_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text("version: 1\ncomparisons: fe.csv\n", encoding="utf-8")
    with pytest.raises(ProtocolError, match=r"expected a list, found 'fe\.csv'"):
        load_calibration_plan(path)
