"""Plans of campaigns, calibrations and comparisons."""

from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.protocol.load import load_calibration_plan, load_campaign_plan
from labpipe.protocol.sheet_grammar import CampaignPlan, FolderPair, NamePair

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
wait_for: [force, markers]
still_for: 3 s
"""


def load(tmp_path: Path, text: str) -> CampaignPlan:
    path = tmp_path / "campaign.yaml"
    path.write_text(text, encoding="utf-8")
    return load_campaign_plan(path)


def test_a_plan_by_names(tmp_path: Path) -> None:
    plan = load(tmp_path, BY_NAME)

    assert isinstance(plan.pair, NamePair)
    assert (plan.pair.source, plan.protocol) == ("incoming", "wire-cantilever")
    assert plan.operator == "bench 2"
    assert list(plan.pair.exports) == ["force", "markers"]
    assert plan.wait_for == ("force", "markers")
    assert (plan.still_for, plan.look_every, plan.patience) == (3.0, 0.25, 60.0)
    assert plan.specimen["labels"] == {"cured": "24 h"}


@pytest.mark.parametrize("text", ["version: 1\n", 'version: 1\npair: {name: "{test}"}\n'])
def test_a_plan_by_folders(tmp_path: Path, text: str) -> None:
    pair = load(tmp_path, text).pair
    assert isinstance(pair, FolderPair)
    assert (pair.name is None) == ("pair" not in text)


def test_the_example_of_the_project(repository: Path) -> None:
    plan = load_calibration_plan(repository / "examples" / "calibration.yaml")
    assert (plan.wire, plan.points) == ("A2", 272)
    assert plan.parameters.radial_friction.enters == "free"


def test_values_are_si(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text(
        "version: 1\nscatter: 3 %\nup_to: 40 mm\nparameters:\n"
        "  radial_friction: {enters: fixed, value: 46.5 mN, because: handbook}\n"
        "  insulation_modulus: {enters: prior, value: 1 GPa, factor: 1.5, because: data sheet}\n",
        encoding="utf-8",
    )
    plan = load_calibration_plan(path)
    assert plan.scatter == pytest.approx(0.03)
    assert plan.up_to == pytest.approx(0.04)
    assert plan.parameters.radial_friction.value == pytest.approx(0.0465)
    assert plan.parameters.insulation_modulus.value == pytest.approx(1e9)
    assert plan.parameters.insulation_modulus.factor == pytest.approx(1.5)


def test_comparisons(tmp_path: Path) -> None:
    """A column, a unit and a sign may be stated; else the curve is as tested."""
    path = tmp_path / "plan.yaml"
    usual = "wire: A2, length: 85 mm, because: a model of solid elements"
    own = "deflection: {column: U2, unit: mm, sign: -1}, force: {column: 3, unit: mN, sign: +1}"
    path.write_text(
        "version: 1\ncomparisons:\n"
        f"  - {{name: finite elements, file: fe.csv, {usual}}}\n"
        f"  - {{name: other, file: sub/fe.csv, load: normal, {usual}, {own}}}\n",
        encoding="utf-8",
    )
    plain, stated = load_calibration_plan(path).comparisons
    assert (plain.name, plain.file, plain.wire) == ("finite elements", "fe.csv", "A2")
    assert plain.length == pytest.approx(0.085)
    assert plain.load == "as tested"
    for column in (plain.deflection, plain.force):
        assert (column.column, column.unit, column.sign) == (None, None, 1)
    across, up = stated.deflection, stated.force
    assert (across.column, across.unit, across.sign) == ("U2", "mm", -1)
    assert (up.column, up.unit, up.sign) == ("3", "mN", 1)
    assert (stated.load, stated.file) == ("normal", "sub/fe.csv")
