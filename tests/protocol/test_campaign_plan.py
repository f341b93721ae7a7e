from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.campaign_plan import ByFolder, ByName, CampaignPlan
from labpipe.protocol.load import load_campaign_plan

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


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("_force.mat", "_{forse}.mat", "line 7, column 12 (pair.exports.force): expected one of"),
        ("-{sample}.csv", ".csv", "(pair.exports.markers): expected the fields of 'force'"),
        ("{type}-{length mm}-{sample}.csv", "take.csv", "expected a field at least, found none"),
        ("spool: A2-s1", "spol: A2-s1", "(specimen.spol): expected a known key"),
        ("152.4 mm", "152.4", "(specimen.span): expected a quantity with a unit"),
        (", because: set so", "", "(overrides.rig.cycles): expected the key 'because'"),
        ("still_for: 3 s", "still_for: 3", "(still_for): expected a quantity with a unit"),
        ("by: name", "by: names", "(pair.by): expected one of"),
        ("operator:", "operater:", "Did you mean 'operator'?"),
    ],
)
def test_what_is_wrong_is_said_at_its_place(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert BY_NAME.count(old) == 1
    with pytest.raises(ProtocolError) as info:
        load(tmp_path, BY_NAME.replace(old, new))
    assert message in str(info.value)
    assert len(str(info.value).splitlines()) == 1
