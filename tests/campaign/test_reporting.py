"""From results on disk to the groups of a report."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from labpipe.campaign.decisions import Decision, add_decisions, without_rejected
from labpipe.campaign.reporting import (
    RECIPE_FILE,
    Beside,
    Recipe,
    Wanted,
    make_campaign,
    report_tests,
)
from labpipe.errors import LabpipeError, StoreError, UsageError
from labpipe.process.run import process_test
from labpipe.process.targets import find_results
from labpipe.report.lab_report import Letterhead
from tests.builders.bundles import EXAMPLES
from tests.builders.pulls import broken, pull, slipped
from tests.builders.tensile_tests import TensileLab, write_pull

KINDS = {"T-1": ("tube", 5e3), "T-2": ("tube", 5.1e3), "H-1": ("hose", 4e3), "H-2": ("hose", 4.1e3)}


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
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
        process_test(lab.sheet, figures=False)
    return home / "processed"


@pytest.fixture
def results(done: Path, tmp_path: Path) -> Path:
    shutil.copytree(done, tmp_path / "processed")
    return tmp_path / "processed"


def test_groups(done: Path) -> None:
    said: list[str] = []
    campaign = make_campaign(find_results([done]), "Pulls", said.append)
    assert said == sorted(KINDS)
    assert campaign.title == "Pulls"
    assert [group.name for group in campaign.groups] == ["hose", "tube"]
    assert [group.protocol for group in campaign.groups] == ["tensile", "tensile"]
    hose, tube = campaign.groups
    assert [sample.test for sample in tube.samples] == ["T-1", "T-2"]
    stiffness = {number.name: number for number in hose.numbers}["stiffness"]
    assert stiffness.mean is not None
    assert stiffness.mean.chosen.mean == pytest.approx(4050.0, rel=0.01)
    assert not campaign.left_out


def test_what_speaks_of_one_test_has_no_mean(done: Path) -> None:
    """The first slip of one sample is no other sample's first slip."""
    tube = make_campaign(find_results([done]), "").groups[1]
    assert not [number.name for number in tube.numbers if number.name.startswith("slip_")]
    assert [len(sample.slips) for sample in tube.samples] == [0, 1]
    names = {each.name for each in tube.samples[1].results}
    assert {"slip_position.1", "slip_drop.1"} <= names


def stored_protocol(results: Path, old: str, new: str) -> None:
    """Change the protocol that every result has stored."""
    import h5py

    for file in results.rglob("result.h5"):
        with h5py.File(file, "r+") as opened:
            text = str(opened.attrs["protocol_yaml"])
            assert old in text
            opened.attrs["protocol_yaml"] = text.replace(old, new)


def test_main_numbers_come_first_and_are_compared(results: Path) -> None:
    said = "main: [energy_to_break, stiffness]\n  margin: 5 %"
    stored_protocol(results, "main: []", said)
    campaign = make_campaign(find_results([results]), "")
    assert [number.name for number in campaign.groups[0].numbers][:2] == [
        "energy_to_break",
        "stiffness",
    ]
    assert {each.name for each in campaign.differences} == {"energy_to_break", "stiffness"}
    (difference,) = (each for each in campaign.differences if each.name == "stiffness")
    assert (difference.first, difference.second) == ("hose", "tube")
    assert difference.difference.mean == pytest.approx(1000.0, rel=0.05)
    assert difference.margin == pytest.approx(0.05 * 4050.0, rel=0.01)


def test_a_result_that_cannot_be_read_is_left_out(results: Path) -> None:
    bad = results / "c" / "T-1" / "result.h5"
    bad.write_bytes(b"nothing")
    campaign = make_campaign(find_results([results]), "")
    assert [len(group.samples) for group in campaign.groups] == [2, 1]
    assert list(campaign.left_out) == [str(bad)]
    assert "expected a result file, found a file that is not HDF5" in campaign.left_out[str(bad)]


def test_a_rejected_test_is_left_out_and_named(results: Path) -> None:
    files = find_results([results])
    campaign = results / "c"
    assert [file.relative_to(campaign).as_posix() for file in files][3] == "T-2/result.h5"
    said = {"because": "slipped <b>twice</b>", "by": "A. Tester", "when": "2026-03-10"}
    runs = [json.loads((file.parent / "summary.json").read_text("utf-8"))["run"] for file in files]
    decide = [
        Decision("T-2", runs[3], "reject", **said),
        Decision("T-1", "another key", "reject", **said),
        Decision("H-1", runs[0], "reject", **said),
        Decision("H-1", runs[0], "accept", **said),
    ]
    add_decisions(campaign, "c", decide)
    reported = report_tests([results])
    assert [[each.test for each in group.samples] for group in reported.campaign.groups] == [
        ["H-1", "H-2"], ["T-1"],
    ]  # fmt: skip
    assert reported.campaign.rejected == {
        str(files[3]): "slipped <b>twice</b> (A. Tester, 2026-03-10)"
    }
    assert reported.campaign.left_out == {}
    page = (reported.folder / "report.html").read_text("utf-8")
    assert "1 rejected" in page
    assert "Tests that were rejected" in page
    assert "lipped &lt;b&gt;twice&lt;/b&gt; (A. Tester, 2026-03-10)" in page
    assert "<b>twice" not in page


def test_results_that_count(results: Path) -> None:
    files = find_results([results])
    assert without_rejected(files) == (files, {})
    run = json.loads((files[0].parent / "summary.json").read_text("utf-8"))["run"]
    add_decisions(results / "c", "c", [Decision("H-1", run, "reject", "slipped", "A. Tester")])
    assert without_rejected(files) == (files[1:], {files[0]: "slipped (A. Tester)"})
    with pytest.raises(UsageError, match=r"result\.h5: rejected: slipped \(A\. Tester\)"):
        without_rejected(files[:1])


def test_a_report_without_readable_decisions_is_refused(results: Path) -> None:
    (results / "c" / "decisions.json").write_text("{", "utf-8")
    with pytest.raises(StoreError, match=r"decisions\.json, line 1, column 2: expected decisions"):
        report_tests([results])
    (results / "c" / "decisions.json").unlink()
    files = find_results([results])
    runs = [json.loads((file.parent / "summary.json").read_text("utf-8"))["run"] for file in files]
    for file, run in zip(files, runs, strict=True):
        decision = Decision(file.parent.name, run, "reject", "all slipped", "A. Tester")
        add_decisions(results / "c", "c", [decision])
    with pytest.raises(UsageError, match=r"H-1.*: rejected: all slipped"):
        report_tests([results])


def test_no_result_can_be_read(results: Path) -> None:
    files = find_results([results])
    for file in files:
        file.write_bytes(b"nothing")
    with pytest.raises(UsageError, match=r"H-1.*\n.*H-2.*\n.*T-1.*\n.*T-2"):
        make_campaign(files, "")


def test_a_report_lies_beside_the_tests(results: Path) -> None:
    reported = report_tests([results])
    assert reported.folder == results / "c" / "report"
    assert reported.campaign.title == "c"
    assert reported.files[0] == reported.folder / "report.html"
    assert all(file.is_file() for file in reported.files)
    one = report_tests([results / "c" / "T-1"], title="One")
    assert one.folder == results / "c" / "report"
    assert one.campaign.title == "One"


def labelled(results: Path, labels: dict[str, str]) -> None:
    """Let test sheets say a label, as the result files keep it."""
    import h5py

    for test, word in labels.items():
        with h5py.File(results / "c" / test / "result.h5", "r+") as opened:
            for name, said in (("labels", "cured"), ("label_words", word)):
                data = np.array([said], dtype=object)
                opened["specimen"].attrs.create(name, data, dtype=h5py.string_dtype())


def test_a_report_is_made_again_as_it_was(results: Path, tmp_path: Path) -> None:
    letterhead = Letterhead((("Customer", "a"), ("Order", "4711")), "data:x")
    beside, wanted = Beside(letterhead, ("png",), True), Wanted(("spool",), "", tmp_path / "w.xlsx")
    made = Recipe("Tubes", wanted, beside)
    (tmp_path / RECIPE_FILE).write_text(made.text(tmp_path), encoding="utf-8")
    assert Recipe.read(tmp_path) == made
    typed = Recipe("Other", beside=Beside(Letterhead((("Order", "4712"),))))
    again = typed.or_earlier(Recipe.read(tmp_path))
    assert (again.title, again.wanted) == ("Other", wanted)
    assert again.beside.letterhead.facts == (("Customer", "a"), ("Order", "4712"))
    assert again.beside.letterhead.logo == "data:x"
    assert Recipe.read(results) == Recipe()
    report = report_tests([results], title="Tubes", beside=Beside(letterhead))
    assert Recipe.read(report.folder).beside.letterhead == letterhead


def test_groups_by_a_field_of_the_sheets(results: Path) -> None:
    labelled(results, {"T-1": "24 h", "H-1": "24 h", "T-2": "48 h"})
    stored_protocol(results, "main: []", "main: [stiffness]")
    by_cure = make_campaign(find_results([results]), "", wanted=Wanted(by=("cured",)))
    assert [group.name for group in by_cure.groups] == ["without cured", "cured 24 h", "cured 48 h"]
    assert by_cure.by == ("cured",)
    none, first, _ = by_cure.groups
    assert first.fields["cured"] == "24 h"
    assert none.notes[0].message == "the test sheets of these samples do not say cured"
    assert [each.fields for each in by_cure.differences if each.question] == [
        {"cured": ("not said", "24 h")},
        {"cured": ("24 h", "48 h")},
    ]
    assert by_cure.differences[-1].fields == {
        "type": ("hose", "tube"), "cured": ("not said", "48 h")
    }  # fmt: skip


def test_only_pairs_that_differ_in_one_field(results: Path) -> None:
    labelled(results, {"T-1": "24 h", "T-2": "48 h"})
    stored_protocol(results, "main: []", "main: [stiffness]")
    wanted = Wanted(by=("type", "cured"), alone="cured")
    campaign = make_campaign(find_results([results]), "", wanted=wanted)
    assert [group.name for group in campaign.groups] == [
        "hose, without cured", "tube, cured 24 h", "tube, cured 48 h"
    ]  # fmt: skip
    (difference,) = campaign.differences
    assert difference.fields == {"cured": ("24 h", "48 h")}
    assert (campaign.compared, campaign.pairs_not_shown) == ("cured", 2)


def test_a_field_that_no_sheet_has(done: Path) -> None:
    files = find_results([done])
    for wanted, option in ((Wanted(by=("tipe",)), "--by"), (Wanted(alone="tipe"), "--compare")):
        with pytest.raises(UsageError) as told:
            make_campaign(files, "", wanted=wanted)
        assert str(told.value).startswith(
            f"{option}: expected fields of these test sheets, which are type, spool"
        )
        assert str(told.value).endswith("found 'tipe'. Write type, or another of them.")


def test_a_wire_sheet_is_named_and_read_first(done: Path) -> None:
    campaign = make_campaign(find_results([done]), "", wanted=Wanted(wires=EXAMPLES))
    assert (campaign.wire_sheet, campaign.places) == ("wires.xlsx", ())
    said: list[str] = []
    with pytest.raises(LabpipeError, match=r"none\.xlsx"):
        make_campaign(find_results([done]), "", said.append, Wanted(wires=Path("none.xlsx")))
    assert not said


def test_spools_of_several_types_are_told_apart(results: Path) -> None:
    labelled(results, dict.fromkeys(KINDS, "24 h"))
    (group,) = make_campaign(find_results([results]), "", wanted=Wanted(by=("cured",))).groups
    spools = {sample.specimen.spool for sample in group.samples}
    assert len(spools) == 2
    assert all(spool.startswith(("hose ", "tube ")) for spool in spools)
    assert "spools_renamed" in [note.code for note in group.notes]


def test_what_a_killed_process_left_is_no_sample(results: Path) -> None:
    test = results / "c" / "T-1"
    (test / ".labpipe.new").mkdir()
    shutil.copy(test / "result.h5", test / ".labpipe.new")
    campaign = make_campaign(find_results([results]), "")
    assert [len(group.samples) for group in campaign.groups] == [2, 2]


def test_two_tests_of_one_name_are_refused(results: Path, tmp_path: Path) -> None:
    shutil.copytree(results / "c" / "T-1", results / "d" / "T-1")
    said = (
        r"d.T-1.result\.h5: expected one test for each name, found a second for 'T-1'\. .*c.T-1.res"
    )
    with pytest.raises(UsageError, match=said):
        report_tests([results], out=tmp_path / "report")
    assert not (tmp_path / "report").exists()


def renamed(file: Path, name: str) -> None:
    import h5py

    with h5py.File(file, "r+") as opened:
        opened.attrs["test"] = name


def test_a_recording_is_counted_once(results: Path) -> None:
    """Two sheets that name the same export, as where a line was not changed after copying."""
    copy = results / "c" / "T-1x" / "result.h5"
    shutil.copytree(results / "c" / "T-1", copy.parent)
    renamed(copy, "T-1x")
    campaign = make_campaign(find_results([results]), "")
    assert [len(group.samples) for group in campaign.groups] == [2, 2]
    assert campaign.left_out == {
        str(
            copy
        ): f"{copy}: expected each recording once, found the same exports, byte for byte, as"
        f" in {results / 'c' / 'T-1' / 'result.h5'}. Look at `files` in both test sheets, or leave"
        " the copy out."
    }
