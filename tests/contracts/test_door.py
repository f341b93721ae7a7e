"""``import labpipe``: cheap, and its names do what the pages say."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import labpipe
from labpipe.errors import LabpipeError, ProtocolError, StoreError, UsageError
from tests.builders.small_tests import Lab, Run


@pytest.fixture(scope="module")
def processed(pristine: Lab, tmp_path_factory: pytest.TempPathFactory) -> Lab:
    from labpipe.cli import main

    lab = pristine.copy(tmp_path_factory.mktemp("door"))
    assert main(["process", str(lab.raw)]) == 0
    return lab


def python(code: str) -> str:
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return ran.stdout.strip()


def test_importing_labpipe_imports_nothing_else() -> None:
    """Nothing outside of the standard library: what of that is there already differs by machine."""
    new = "{name.partition('.')[0] for name in {*sys.modules} - old} - sys.stdlib_module_names"
    code = f"import sys; old = {{*sys.modules}}; import labpipe; print(*sorted({new}))"
    assert python(code) == "labpipe"
    assert python("import sys, labpipe; print('labpipe.door' in sys.modules)") == "False"


def test_names_are_found_when_they_are_asked_for() -> None:
    assert {"open", "process", "table", "groups", "inspect", "Test", "Export"} <= set(dir(labpipe))
    assert labpipe.open is labpipe.door.open
    with pytest.raises(AttributeError, match="module 'labpipe' has no attribute 'opne'"):
        labpipe.opne  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.slow
@pytest.mark.parametrize("first", ["import labpipe.process.run", "import labpipe.door", "pass"])
def test_process_is_a_function_and_a_package(first: str) -> None:
    code = (
        f"{first}\nimport labpipe\nprint(callable(labpipe.process))\n"
        "import labpipe.process.run\nprint(labpipe.process.run.FIGURES)"
    )
    assert python(code).split() == ["True", "figures"]


@pytest.mark.slow
@pytest.mark.parametrize("given", [Path, str])
def test_a_test_opens_by_its_folder_and_by_its_file(given: type, processed: Lab) -> None:
    by_folder, by_file = labpipe.open(given(processed.processed)), labpipe.open(processed.result)
    assert by_folder.summary == by_file.summary == processed.summary
    assert by_folder.folder == processed.processed
    assert len(by_folder.raw["force"]) > 1000
    assert {"markers", "markers/Clamp"} <= set(by_folder.raw)
    assert len(by_folder.shape) == len(by_folder.raw["markers"])


@pytest.mark.slow
def test_processing_in_memory_gives_the_same_and_writes_nothing(processed: Lab) -> None:
    before = {path: path.stat().st_mtime_ns for path in processed.home.rglob("*")}
    wanted = labpipe.open(processed.processed)
    for source in (processed.raw, processed.sheet, processed.result, processed.processed):
        made = labpipe.process(source)
        assert made.summary == wanted.summary
        assert made.results.equals(wanted.results)
        assert made.curve.equals(wanted.curve)
        assert made.folder is None
    assert {path: path.stat().st_mtime_ns for path in processed.home.rglob("*")} == before


def test_what_cannot_be_opened_is_said(processed: Lab, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"expected a result\.h5, or a folder with processed test"):
        labpipe.open(processed.raw)
    with pytest.raises(UsageError, match="found nothing of that name"):
        labpipe.open(tmp_path / "none")
    (tmp_path / "result.h5").write_bytes(b"no")
    with pytest.raises(StoreError, match="expected a result file, found a file that is not HDF5"):
        labpipe.open(tmp_path)
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / "result.h5").touch()
    with pytest.raises(UsageError, match=r"expected one test, found 3 of them\. labpipe\.table"):
        labpipe.open(tmp_path)


def test_what_cannot_be_processed_is_said(lab: Lab, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"expected a test\.yaml, a folder that holds one"):
        labpipe.process(tmp_path / "none")
    with pytest.raises(UsageError, match=r"found a \.mat file\. An export belongs to a test"):
        labpipe.process(lab.raw / "force.mat")
    lab.edit("test.yaml", "force.mat", "forse.mat")
    with pytest.raises((ProtocolError, LabpipeError), match=r"forse\.mat"):
        labpipe.process(lab.raw)


def test_a_table_and_an_export(processed: Lab, run: Run) -> None:
    frame = labpipe.table(processed.home / "processed", by=["type", "length"])
    assert frame["result"].tolist() == [each["name"] for each in processed.summary["results"]]
    export = processed.raw / "take.csv"
    assert f"{labpipe.inspect(export)!r}\n" == run("inspect", export).out
