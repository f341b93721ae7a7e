"""Exports become tests: files that stand still, names that are paired, sheets that are written."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from labpipe.campaign.pairing import Candidate, list_candidates, pair_test, read_plan
from labpipe.errors import ProtocolError, StoreError, UsageError
from labpipe.protocol.load import load_test_sheet
from tests.builders.small_tests import Lab, state

BY_NAME = """\
version: 1
protocol: wire-cantilever
pair:
  by: name
  from: incoming
  exports:
    force: "{type}-{length mm}-{sample}_force.mat"
    markers: "{type}-{length mm}-{sample}.csv"
specimen: {spool: A2-s1, labels: {cured: 24 h}}
operator: bench 2
overrides:
  rig.stroke: {value: 12 mm, because: a short stroke}
"""


@pytest.fixture
def campaign(lab: Lab) -> Path:
    """A campaign whose exports lie in one folder, with a campaign YAML."""
    folder = lab.raw.parent
    incoming = folder / "incoming"
    incoming.mkdir()
    (lab.raw / "force.mat").rename(incoming / "A2-085-3_Force.mat")
    (lab.raw / "take.csv").rename(incoming / "A2-085-3.csv")
    shutil.rmtree(lab.raw)
    (folder / "campaign.yaml").write_text(BY_NAME, encoding="utf-8")
    return folder


def only(folder: Path) -> Candidate:
    (candidate,) = list_candidates(folder, read_plan(folder)).candidates
    return candidate


def test_pairing_by_name_writes_sheet_and_copies(campaign: Path) -> None:
    exports = state(campaign / "incoming")
    written = pair_test(only(campaign), read_plan(campaign))
    assert written.sheet == campaign / "A2-085-3" / "test.yaml"
    assert (written.is_new, written.open_keys, written.missing_files) == (True, (), ())
    sheet = load_test_sheet(written.sheet)
    names = (sheet.test, sheet.protocol, sheet.operator, str(sheet.date))
    assert names == ("A2-085-3", "wire-cantilever", "bench 2", "2026-03-04")
    assert (sheet.specimen.spool, sheet.specimen.length) == ("A2-s1", 0.085)
    assert sheet.specimen.labels == {"cured": "24 h"}
    assert sheet.overrides["rig.stroke"].because == "a short stroke"
    assert sheet.files == {"force": ("A2-085-3_Force.mat",), "markers": ("A2-085-3.csv",)}
    assert state(campaign / "incoming") == exports
    copies = {name: mark[0] for name, mark in state(campaign / "A2-085-3").items()}
    assert {name: mark[0] for name, mark in exports.items()}.items() <= copies.items()


def test_existing_sheet_is_not_changed(campaign: Path) -> None:
    candidate = only(campaign)
    pair_test(candidate, read_plan(campaign))
    candidate.sheet.write_text(candidate.sheet.read_text("utf-8") + "# by hand\n", "utf-8")
    content = state(candidate.folder)
    source = campaign / "incoming" / "A2-085-3.csv"
    source.write_text(source.read_text("utf-8") + "\n", "utf-8")

    written = pair_test(only(campaign), read_plan(campaign))

    assert state(candidate.folder) == content
    assert not written.is_new
    assert written.messages == (
        "check: A2-085-3.csv differs from its copy in the test folder, which is used",
    )


def test_missing_or_unreadable_exports_are_awaited(campaign: Path) -> None:
    take = campaign / "incoming" / "A2-085-3.csv"
    moved = take.rename(campaign.parent / "take.csv")
    written = pair_test(only(campaign), read_plan(campaign))
    assert (written.sheet, written.missing_files) == (None, ("markers",))
    assert not (campaign / "A2-085-3").exists()
    moved.rename(take)
    content = take.read_bytes()
    take.write_bytes(b"")
    written = pair_test(only(campaign), read_plan(campaign))
    assert (written.sheet, list(written.read_errors)) == (None, ["A2-085-3.csv"])
    assert not (campaign / "A2-085-3").exists()
    take.write_bytes(content)
    assert pair_test(only(campaign), read_plan(campaign)).sheet is not None


def test_different_file_is_not_overwritten_by_a_copy(campaign: Path) -> None:
    (campaign / "A2-085-3").mkdir()
    file = campaign / "A2-085-3" / "A2-085-3.csv"
    file.write_bytes(b"by hand")
    with pytest.raises(
        StoreError, match=r"expected a copy of .* found a different file of that name"
    ):
        pair_test(only(campaign), read_plan(campaign))
    assert file.read_bytes() == b"by hand"


def test_unmatched_files_have_a_reason(campaign: Path) -> None:
    incoming = campaign / "incoming"
    for name in ("notes.docx", "A2-085-3_FORCE.mat", "A2-085-4_force.mat", "a\nb.csv", "x.yaml"):
        (incoming / name).write_bytes(b"x")

    listing = list_candidates(campaign, read_plan(campaign))

    assert [candidate.name for candidate in listing.candidates] == ["A2-085-3", "A2-085-4"]
    assert {path.name: why for path, why in listing.unused_files.items()} == {
        "notes.docx": "its name fits no pattern in campaign.yaml",
        "a\nb.csv": "its name has control characters; rename it",
        "A2-085-3_Force.mat": "A2-085-3_FORCE.mat is already the force of the same test",
    }


def test_one_folder_per_test(lab: Lab) -> None:
    folder = lab.raw.parent
    lab.sheet.unlink()
    (folder / "loose.csv").write_text("x", encoding="utf-8")
    (folder / "empty").mkdir()
    plan = read_plan(folder)
    listing = list_candidates(folder, plan)
    assert [candidate.name for candidate in listing.candidates] == ["T1"]
    assert listing.unused_files == {folder / "loose.csv": "it is not in the folder of a test"}
    written = pair_test(listing.candidates[0], plan)
    assert written.open_keys == ("protocol", "type", "spool", "sample")
    with pytest.raises(ProtocolError, match=r"specimen\.spool"):
        load_test_sheet(lab.sheet)


SIBLING = """\
test: {0}
protocol: {1}
specimen: {{type: x, spool: "1", sample: "1"}}
files: {{frame: x.csv}}
"""


@pytest.mark.parametrize(
    ("protocols", "stable_time", "missing"),
    [
        ("", 0.0, ("markers",)),
        ("", 1e6, ()),
        ("wire-cantilever wire-cantilever conduit-bundle", 1e6, ("markers",)),
        ("conduit-bundle", 0.0, ()),
        ("tensile", 1e6, ()),
        ("wire-cantilever conduit-bundle", 1e6, ()),
    ],
)
def test_roles_awaited_by_the_protocols_of_other_tests(
    lab: Lab, protocols: str, stable_time: float, missing: tuple[str, ...]
) -> None:
    """Of a bench with wires the take is yet to come; nobody waits for a load frame's export."""
    lab.sheet.unlink()
    (lab.raw / "take.csv").unlink()
    for number, protocol in enumerate(protocols.split()):
        folder = lab.raw.with_name(f"other-{number}")
        folder.mkdir()
        (folder / "x.csv").write_text("x", encoding="utf-8")
        (folder / "test.yaml").write_text(SIBLING.format(folder.name, protocol), encoding="utf-8")
    plan = read_plan(lab.raw.parent)
    candidates = list_candidates(lab.raw.parent, plan).candidates
    candidate_of_test = next(candidate for candidate in candidates if candidate.folder == lab.raw)
    written = pair_test(candidate_of_test, plan, stable_time=stable_time)
    assert (written.missing_files, written.sheet is None) == (missing, bool(missing))


def test_written_sheet_awaits_its_exports(lab: Lab) -> None:
    (lab.raw / "take.csv").unlink()
    written = pair_test(only(lab.raw.parent), read_plan(lab.raw.parent))
    assert (written.sheet, written.missing_files) == (None, ("take.csv",))


def test_faulty_plan_is_refused(campaign: Path) -> None:
    plan = campaign / "campaign.yaml"
    plan.write_text(BY_NAME.replace("{type}", "{labels.Type}"), encoding="utf-8")
    with pytest.raises(ProtocolError, match="expected one of"):
        read_plan(campaign)
    plan.write_text(BY_NAME.replace("wire-cantilever", "wire-cantilver"), encoding="utf-8")
    with pytest.raises(UsageError, match="Did you mean 'wire-cantilever'"):
        pair_test(only(campaign), read_plan(campaign))
