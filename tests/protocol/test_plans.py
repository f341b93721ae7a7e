"""Plans of campaigns, calibrations and comparisons."""

from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.campaign_plan import ByFolder, ByName, CampaignPlan
from labpipe.protocol.load import load_calibration_plan, load_campaign_plan
from labpipe.protocol.plans import CalibrationPlan

BY_NAME = """\
version: 1
protocol: wire-cantilever
pair:
  by: name
  from: incoming
  exports:
    force: "{type}-{length mm}-{sample}_force.mat"
    markers: "{type}-{length mm}-{sample}.csv"
specimen: {spool: A2-s1, span: 152.4 mm, labels: {cured: 24 h}}
operator: bench 2
overrides:
  rig.cycles: {value: 2, because: set so}
wait_for: [force, markers, force]
still_for: 3 s
"""


def load(tmp_path: Path, text: str) -> CampaignPlan:
    path = tmp_path / "campaign.yaml"
    path.write_text(text, encoding="utf-8")
    return load_campaign_plan(path)


def test_a_plan_by_names(tmp_path: Path) -> None:
    plan = load(tmp_path, BY_NAME)

    assert isinstance(plan.pair, ByName)
    assert (plan.pair.source, plan.protocol, plan.operator) == (
        "incoming",
        "wire-cantilever",
        "bench 2",
    )
    assert list(plan.pair.patterns) == ["force", "markers"]
    assert plan.wait_for == ("force", "markers")
    assert (plan.still_for, plan.look_every, plan.patience) == (3.0, 0.25, 60.0)
    assert plan.specimen["labels"] == {"cured": "24 h"}


@pytest.mark.parametrize("text", ["version: 1\n", 'version: 1\npair: {name: "{test}"}\n'])
def test_a_plan_by_folders(tmp_path: Path, text: str) -> None:
    pair = load(tmp_path, text).pair
    assert isinstance(pair, ByFolder)
    assert (pair.pattern is None) == ("pair" not in text)


def plan_of(folder: Path, text: str) -> Path:
    path = folder / "calibration.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def told(folder: Path, text: str) -> str:
    path = plan_of(folder, text)
    with pytest.raises(ProtocolError) as caught:
        load_calibration_plan(path)
    return str(caught.value).replace(str(path), "plan")


def test_the_example_of_the_project(repository: Path) -> None:
    plan = load_calibration_plan(repository / "examples" / "calibration.yaml")
    assert (plan.wire, plan.points) == ("A2", 272)
    assert plan.parameters.radial_friction.enters == "free"


def test_values_are_si(tmp_path: Path) -> None:
    text = (
        "version: 1\nscatter: 3 %\nup_to: 40 mm\nparameters:\n"
        "  radial_friction: {enters: fixed, value: 46.5 mN, because: handbook}\n"
        "  insulation_modulus: {enters: prior, value: 1 GPa, factor: 1.5, because: data sheet}\n"
    )
    plan = load_calibration_plan(plan_of(tmp_path, text))
    assert plan.scatter == pytest.approx(0.03)
    assert plan.up_to == pytest.approx(0.04)
    assert plan.parameters.radial_friction.value == pytest.approx(0.0465)
    assert plan.parameters.insulation_modulus.value == pytest.approx(1e9)
    assert plan.parameters.insulation_modulus.factor == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("block", "said"),
    [
        ("{enters: prior, factor: 1.5, because: x}", "expected a value of what is prior"),
        ("{enters: fixed, because: x}", "expected a value of what is fixed"),
        ("{enters: fixed, value: 1 GPa}", "expected a source of what is fixed"),
        ("{enters: prior, value: 1 GPa, because: x}", "expected the width of a prior"),
        ("{factor: 1.5}", "expected no factor, found one without a prior"),
        ("{enters: guessed}", "found 'guessed'"),
        ("{value: 1000}", "found '1000'"),
        ("{enters: prior, value: 1 GPa, factor: 0.5, because: x}", "found '0.5'"),
    ],
)
def test_a_parameter_that_cannot_be(tmp_path: Path, block: str, said: str) -> None:
    message = told(tmp_path, f"version: 1\nparameters:\n  insulation_modulus: {block}\n")
    assert message.startswith("plan, line 3")
    assert said in message


USUAL = {
    "name": "finite elements",
    "file": "fe.csv",
    "wire": "A2",
    "length": "85 mm",
    "because": "a model of solid elements",
}


def comparing(folder: Path, *comparisons: dict[str, str]) -> Path:
    path = folder / "plan.yaml"
    lines = [
        f"  - {{{', '.join(f'{key}: {value}' for key, value in comparison.items())}}}"
        for comparison in comparisons
    ]
    path.write_text("\n".join(["version: 1", "comparisons:", *lines, ""]), encoding="utf-8")
    return path


def read(folder: Path, *comparisons: dict[str, str]) -> CalibrationPlan:
    return load_calibration_plan(comparing(folder, *comparisons))


def refused(folder: Path, *comparisons: dict[str, str]) -> str:
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
    message = refused(tmp_path, USUAL | change)
    assert message.startswith("plan, line 3")
    assert said in message


@pytest.mark.parametrize("key", list(USUAL))
def test_what_must_be_said(tmp_path: Path, key: str) -> None:
    message = refused(tmp_path, {name: value for name, value in USUAL.items() if name != key})
    assert f"expected the key '{key}', found no such key. Add the key '{key}'." in message


def test_names_are_their_own(tmp_path: Path) -> None:
    assert refused(tmp_path, USUAL, USUAL | {"name": "paper"}, USUAL) == (
        "plan, line 5, column 12 (comparisons.2.name): expected a name of its own, found 'finite "
        "elements', as comparison 1. Call it something else."
    )
