"""From results on disk to the samples, groups and pages of a report."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.campaign.decisions import Decision, add_decisions, exclude_rejected_tests
from labpipe.campaign.reporting import (
    OPTIONS_FILE,
    ReportOptions,
    add_dimensions,
    list_outputs,
    make_campaign,
    make_sample,
    read_tests,
    report_tests,
)
from labpipe.errors import StoreError, UsageError
from labpipe.process.output_paths import find_results
from labpipe.process.run import Task, process
from labpipe.protocol.load import list_protocols, load_protocol
from labpipe.protocol.schema import SpecimenBlock
from labpipe.protocol.source import Section
from labpipe.records.group import Sample
from labpipe.records.result import Specimen, TestResult
from labpipe.store.result_files import read_result
from tests.builders.pulls import broken, pull, slipped
from tests.builders.tensile_tests import TensileLab, write_pull

KINDS = {"T-1": ("tube", 5e3), "T-2": ("tube", 5.1e3), "H-1": ("hose", 4e3), "H-2": ("hose", 4.1e3)}


@pytest.fixture(scope="module")
def pulls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two tubes and two hoses, pulled by `tensile` until they broke, one with a slip."""
    home = tmp_path_factory.mktemp("done")
    for seed, (name, (kind, stiffness)) in enumerate(KINDS.items()):
        lab = TensileLab(home, name)
        travel, force = pull(stiffness=stiffness, slack=0.001, seed=seed)
        force = slipped(travel, force, (0.012, 3.0)) if name == "T-2" else force
        write_pull(lab, "tensile", broken(travel, force, at=0.018), travel)
        text = lab.sheet.read_text("utf-8").replace("type: synthetic", f"type: {kind}")
        lab.sheet.write_text(text, "utf-8")
        lab.override("curve.slips.decision", "repaired")
        process(Task(lab.sheet, figures=False))
    return home / "processed"


@pytest.fixture
def results(pulls: Path, tmp_path: Path) -> Path:
    shutil.copytree(pulls, tmp_path / "processed")
    return tmp_path / "processed"


def runs_of(files: list[Path]) -> list[str]:
    return [json.loads((file.parent / "summary.json").read_text("utf-8"))["run"] for file in files]


def test_rejected_tests_are_left_out_with_reason(results: Path) -> None:
    files = find_results([results])
    runs = runs_of(files)
    assert exclude_rejected_tests(files) == (files, {})
    facts = {"because": "slipped <b>twice</b>", "by": "A. Tester", "when": "2026-03-10"}
    decisions = [
        Decision("T-2", runs[3], "reject", **facts),
        Decision("T-1", "another key", "reject", **facts),
        Decision("H-1", runs[0], "reject", **facts),
        Decision("H-1", runs[0], "accept", **facts),
    ]
    add_decisions(results / "c", "c", decisions)
    reported = report_tests([results])
    (group,) = reported.campaign.groups
    assert [sample.test for sample in group.samples] == ["H-1", "H-2"]
    remark = "(needs a new decision: exports, sheet, protocol or labpipe changed since)"
    assert reported.campaign.rejected == {
        str(files[2]): f"slipped <b>twice</b> {remark} (A. Tester, 2026-03-10)",
        str(files[3]): "slipped <b>twice</b> (A. Tester, 2026-03-10)",
    }
    assert reported.campaign.failures == {}
    page = (reported.folder / "report.html").read_text("utf-8")
    assert "2 rejected" in page
    assert "lipped &lt;b&gt;twice&lt;/b&gt; (A. Tester, 2026-03-10)" in page
    assert "<b>twice" not in page


def test_report_of_rejected_tests_only_is_refused(results: Path) -> None:
    files = find_results([results])
    decisions = [
        Decision(file.parent.name, run, "reject", "all slipped", "A. Tester")
        for file, run in zip(files, runs_of(files), strict=True)
    ]
    add_decisions(results / "c", "c", decisions)
    with pytest.raises(UsageError, match=r"H-1.*: rejected: all slipped \(A\. Tester\)"):
        report_tests([results])
    (results / "c" / "decisions.json").write_text("{", "utf-8")
    with pytest.raises(StoreError, match=r"decisions\.json, line 1, column 2: expected decisions"):
        report_tests([results])


@pytest.fixture
def labelled(results: Path) -> list[Path]:
    """Results whose sheets say a label, and whose protocol has main numbers."""
    import h5py

    for file in results.rglob("result.h5"):
        cured = {"T-1": "24 h", "T-2": "48 h"}.get(file.parent.name)
        with h5py.File(file, "r+") as root:
            text = str(root.attrs["protocol_yaml"])
            root.attrs["protocol_yaml"] = text.replace(
                "main: []", "main: [energy_to_break, stiffness]\n  margin: 5 %"
            )
            for name, word in (("labels", "cured"), ("label_words", cured)) if cured else ():
                data = np.array([word], dtype=object)
                root["specimen"].attrs.create(name, data, dtype=h5py.string_dtype())
    return find_results([results])


def test_main_results_come_first_and_are_compared(labelled: list[Path]) -> None:
    tests: list[str] = []
    campaign = make_campaign(read_tests(labelled, tests.append), "Pulls", ReportOptions())
    assert (tests, campaign.title, campaign.failures) == (sorted(KINDS), "Pulls", {})
    assert [group.name for group in campaign.groups] == ["hose", "tube"]
    assert {group.protocol for group in campaign.groups} == {"tensile"}
    hose, tube = campaign.groups
    assert [sample.test for sample in tube.samples] == ["T-1", "T-2"]
    main = ["energy_to_break", "stiffness"]
    assert [number.name for number in hose.numbers][:2] == main
    assert hose.numbers[1].mean.chosen.mean == pytest.approx(4050.0, rel=0.01)
    differences = {difference.name: difference for difference in campaign.differences}
    assert set(differences) == set(main)
    difference = differences["stiffness"]
    assert (difference.first, difference.second) == ("hose", "tube")
    assert difference.difference.mean == pytest.approx(1000.0, rel=0.05)
    assert difference.margin == pytest.approx(0.05 * 4050.0, rel=0.01)


def test_groups_by_a_field_of_the_sheets(labelled: list[Path]) -> None:
    by_cure = make_campaign(read_tests(labelled, str), "", ReportOptions(by=("cured",)))
    assert [group.name for group in by_cure.groups] == ["without cured", "cured 24 h", "cured 48 h"]
    assert by_cure.grouping_fields == ("cured",)
    none, first, _ = by_cure.groups
    assert first.fields["cured"] == "24 h"
    assert none.notes[0].message == "the test sheets of these samples do not state cured"
    single_fields = [x.fields for x in by_cure.differences if x.single_field]
    assert single_fields == [{"cured": ("24 h", "48 h")}] * 2
    fields = {"type": ("hose", "tube"), "cured": ("not stated", "48 h")}
    assert by_cure.differences[-1].fields == fields
    options = ReportOptions(by=("type", "cured"), alone="cured")
    campaign = make_campaign(read_tests(labelled, str), "", options)
    names = [group.name for group in campaign.groups]
    assert names == ["hose, without cured", "tube, cured 24 h", "tube, cured 48 h"]
    assert {str(x.fields) for x in campaign.differences} == {"{'cured': ('24 h', '48 h')}"}
    assert (campaign.compared_field, campaign.pairs_not_shown) == ("cured", 2)


def test_report_options_round_trip(results: Path, tmp_path: Path) -> None:
    letterhead, wires = {"Customer": "a", "Order": "4711"}, tmp_path / "w.xlsx"
    options = ReportOptions("Tubes", ("spool",), "", wires, letterhead, "data:x", ("png",), True)
    (tmp_path / OPTIONS_FILE).write_text(options.write_json(tmp_path), encoding="utf-8")
    assert ReportOptions.read(tmp_path) == options
    typed = ReportOptions("Other", letterhead={"Order": "4712"})
    filled = typed.fill_from(ReportOptions.read(tmp_path))
    assert filled == replace(options, title="Other", letterhead={**letterhead, **typed.letterhead})
    assert ReportOptions.read(results) == ReportOptions()
    options = ReportOptions("Tubes", letterhead=letterhead)
    report = report_tests([results], options=options)
    assert ReportOptions.read(report.folder) == options


def test_copied_recordings_are_left_out(results: Path) -> None:
    """Two sheets that name the same export, and what a killed process left."""
    import h5py

    test, copy = results / "c" / "T-1", results / "c" / "T-1x" / "result.h5"
    shutil.copytree(test, copy.parent)
    with h5py.File(copy, "r+") as root:
        root.attrs["test"] = "T-1x"
    (test / ".labpipe.new").mkdir()
    shutil.copy(test / "result.h5", test / ".labpipe.new")
    campaign = make_campaign(read_tests(find_results([results]), str), "", ReportOptions())
    assert [len(group.samples) for group in campaign.groups] == [2, 2]
    ((file, reason),) = campaign.failures.items()
    assert file == str(copy)
    assert f"found the same exports or samples as in {test / 'result.h5'}." in reason


def test_two_tests_with_one_name_are_refused(results: Path, tmp_path: Path) -> None:
    shutil.copytree(results / "c" / "T-1", results / "d" / "T-1")
    message = (
        r"d.T-1.result\.h5: expected one test for each name, found a second for 'T-1'\. .*c.T-1.res"
    )
    with pytest.raises(UsageError, match=message):
        report_tests([results], out=tmp_path / "report")
    assert not (tmp_path / "report").exists()


def read_pull(pulls: Path, name: str) -> TestResult:
    return read_result(pulls / "c" / name / "result.h5")


def sample_of(result: TestResult, source: str = "") -> Sample:
    return replace(make_sample(result), source=source)


def test_sample_has_thinned_branches_up_to_the_failure(pulls: Path) -> None:
    result = read_pull(pulls, "T-1")
    sample = sample_of(result, "here")
    assert (sample.test, sample.source, sample.specimen.type) == ("T-1", "here", "tube")
    (branch,) = sample.loading
    assert not sample.unloading
    assert 400 < len(branch.displacement) <= 1000
    assert (np.diff(branch.displacement) > 0.0).all()
    values = {number.name: number.value for number in result.results}
    failure = values["failure_displacement"]
    assert failure is not None
    assert branch.displacement[-1] == pytest.approx(failure, abs=4e-5)
    assert branch.force.min() > -0.1
    line = 5e3 * np.maximum(branch.displacement, 0.0)
    np.testing.assert_allclose(branch.force, line, atol=0.15)
    np.testing.assert_array_equal(branch.force, branch.measured_force)


def test_repaired_slip_differs_from_the_measured_force(pulls: Path) -> None:
    sample = sample_of(read_pull(pulls, "T-2"))
    (branch,), (slip,) = sample.loading, sample.slips
    added = branch.force - branch.measured_force
    displacement = branch.displacement
    assert np.abs(added[displacement < slip.position - 1e-4]).max() == 0.0
    np.testing.assert_allclose(added[displacement > slip.position + 1e-4], slip.drop)


def test_add_sizes_prefers_the_test_sheet() -> None:
    section = Section.model_validate({"width": "18.8 mm", "area": "5 mm^2"})
    block = SpecimenBlock.model_validate({"length": "300 mm", "section": section})
    specimen = add_dimensions(Specimen("tape", "s1", "1", {"length": 0.25}), block)
    assert specimen.dimensions == {"length": 0.25, "width": 0.0188}
    bare = Specimen("tape", "s1", "1")
    assert add_dimensions(bare, SpecimenBlock()) == bare


@pytest.mark.parametrize(
    ("name", "signed", "by_stroke"),
    [
        ("conduit-bundle", {"clock_offset", "clock_drift", "end_slope"}, {"peak_displacement"}),
        ("pet-tape", {"slack"}, set()),
    ],
)
def test_outputs_of_a_protocol(name: str, signed: set[str], by_stroke: set[str]) -> None:
    outputs = list_outputs(load_protocol(list_protocols()[name]))
    assert {name for name, output in outputs.items() if output.can_be_negative} == signed
    assert {name for name, output in outputs.items() if output.is_set_by_stroke} == by_stroke
