from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from labpipe.errors import ProcessingError, ProtocolError, StoreError
from labpipe.process.run import process_test
from labpipe.records.harness_bundle import Bundle, BundleWire
from labpipe.records.result import Status
from labpipe.store.read import read_result
from tests.builders.small_tests import Lab, state


def test_stages_are_told_and_the_result_is_what_is_stored(lab: Lab) -> None:
    said: list[str] = []
    made = process_test(lab.raw / "test.yaml", figures=False, say=said.append)
    assert said == ["read", "process", "write"]
    assert made.folder == lab.processed
    assert (made.figures, made.n_failed) == ((), 0)
    stored = read_result(lab.result)
    assert stored.results == made.result.results
    assert stored.quality == made.result.quality
    assert stored.test_yaml == (lab.raw / "test.yaml").read_text(encoding="utf-8")
    assert "name: wire-cantilever" in stored.protocol_yaml
    assert stored.specimen.dimensions == {"length": 0.085}


@pytest.mark.slow
def test_the_words_on_a_bundle_reach_the_result_and_stay_when_it_is_processed_again(
    lab: Lab,
) -> None:
    path = lab.raw / "test.yaml"
    sheet = yaml.safe_load(path.read_text(encoding="utf-8"))
    sheet["specimen"] |= {
        "bundle": {"wires": "4 B1 + 3 B2", "arrangement": "symmetric"},
        "labels": {"cured": "24 h"},
    }
    path.write_text(yaml.safe_dump(sheet), encoding="utf-8")

    process_test(path, figures=False)
    first = read_result(lab.result).specimen
    process_test(lab.result, figures=False)

    wires = (BundleWire("B1", 4), BundleWire("B2", 3))
    assert first.bundle == Bundle(wires, arrangement="symmetric")
    assert first.labels == {"cured": "24 h"}
    assert read_result(lab.result).specimen == first


def test_a_date_after_the_due_one_of_a_certificate_is_seen_again_and_again(lab: Lab) -> None:
    path = lab.raw / "test.yaml"
    sheet = yaml.safe_load(path.read_text(encoding="utf-8")) | {"date": "2026-02-01"}
    certificate = {"number": "LC-7", "date": "2025-01-10", "due": "2026-01-10"}
    sheet["overrides"]["sources.force.certificate"] = {"value": certificate, "because": "another"}
    path.write_text(yaml.safe_dump(sheet), encoding="utf-8")
    for source in (path, lab.result):
        found = {each.name: each for each in process_test(source, figures=False).result.results}
        assert "calibration_overdue: " in found["peak_force.1"].why
        assert found["peak_displacement.1"].status is Status.OK


def test_failed_results_are_counted(lab: Lab) -> None:
    lab.override("branches.min_stroke", "500 mm")
    made = process_test(lab.raw / "test.yaml", figures=False)
    assert made.n_failed == 10
    assert {each.status for each in made.result.results} == {Status.FAILED}
    assert made.result.curve is None
    assert made.result.shape is not None


def test_folder_beside_raw(lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    elsewhere = tmp_path / "bench"
    elsewhere.mkdir()
    for path in lab.raw.iterdir():
        (elsewhere / path.name).write_bytes(path.read_bytes())
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    made = process_test(elsewhere / "test.yaml", figures=False)
    assert made.folder == Path("processed") / "T1"
    made = process_test(lab.raw / "test.yaml", out=Path("x"), figures=False)
    assert made.folder == Path("x") / "T1"


def test_errors_name_the_test(lab: Lab) -> None:
    lab.override("markers.clamp", "Clmp")
    with pytest.raises(ProcessingError, match=r"T1, markers, rigid bodies: .*'Clamp'.*Name the"):
        process_test(lab.raw / "test.yaml", figures=False)


def test_a_file_that_is_no_result(tmp_path: Path) -> None:
    path = tmp_path / "result.h5"
    path.write_bytes(b"nothing")
    with pytest.raises(StoreError, match=r"result.h5"):
        process_test(path, figures=False)


def test_a_sheet_that_is_none(tmp_path: Path) -> None:
    path = tmp_path / "test.yaml"
    path.write_text("test: T1\n", encoding="utf-8")
    with pytest.raises(ProtocolError, match=r"test.yaml"):
        process_test(path, figures=False)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["../../x", "/tmp/x", "..", "a/b", "", "nul"])
def test_a_name_that_leads_elsewhere(lab: Lab, tmp_path: Path, name: str) -> None:
    import h5py

    process_test(lab.sheet, figures=False)
    with h5py.File(lab.result, "r+") as opened:
        opened.attrs["test"] = name
    before = state(tmp_path)
    said = r"result\.h5, test: expected the name of a test, such as A2-085-1, found '"
    for out in (tmp_path / "deep" / "out", None):
        with pytest.raises(StoreError, match=said):
            process_test(lab.result, out=out, figures=False)
    assert state(tmp_path) == before


def test_a_raw_group_that_is_not_that_of_the_protocol(lab: Lab) -> None:
    import h5py

    process_test(lab.sheet, figures=False)
    with h5py.File(lab.result, "r+") as opened:
        opened["raw/force/force"].attrs["name"] = "farce"
    said = r"raw/force: expected the channels of its protocol, force, found 'farce'\. Process"
    with pytest.raises(StoreError, match=said):
        process_test(lab.result, figures=False)
    with h5py.File(lab.result, "r+") as opened:
        opened["raw/force/force"].attrs["name"] = "force"
        opened["raw/markers/markers/time"][3] = np.inf
    with pytest.raises(StoreError, match=r"raw/markers: expected times that go on, found some"):
        process_test(lab.result, figures=False)
    with h5py.File(lab.result, "r+") as opened:
        opened["raw"].attrs.create("roles", ["markers"], dtype=h5py.string_dtype())
    with pytest.raises(StoreError, match=r"raw/force: expected the channels .*, found none"):
        process_test(lab.result, figures=False)
