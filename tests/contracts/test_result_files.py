from __future__ import annotations

import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import pytest

from labpipe.records.harness_bundle import Bundle, BundleWire
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.result import TestResult
from labpipe.store.result_files import write_result
from tests.builders.measured_bending import some_bending
from tests.store.builders_result import build_result, with_slips

OCTAVE = shutil.which("octave-cli")
needs_octave = pytest.mark.skipif(OCTAVE is None, reason="Octave is not installed")


@pytest.fixture(scope="module")
def result() -> TestResult:
    made = with_slips(build_result(half_cycle=1.0))
    wires = (BundleWire("B1", 1, 0.0011), BundleWire("B2", 1))
    bundle = Bundle(wires, positions=((0.0, 0.0), (0.002, 0.0)))
    note = QualityNote("gap", Severity.WARNING, "Weg in µm", "Größe über 3 µm")
    return replace(
        made,
        bending=some_bending(),
        specimen=replace(made.specimen, bundle=bundle),
        quality=(*made.quality, note),
    )


@pytest.fixture(scope="module")
def path(result: TestResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("other") / "result.h5"
    write_result(result, file)
    return file


def test_every_axis_has_one_scale_of_its_length_in_its_group(path: Path) -> None:
    seen = list[str]()

    def look(name: str, found: object) -> None:
        if not isinstance(found, h5py.Dataset) or found.is_scale:
            return
        for axis, size in zip(found.dims, found.shape, strict=True):
            (scale,) = axis.values()
            assert scale.shape == (size,), name
            assert scale.name.rpartition("/")[2] in found.parent, name
        seen.append(name)

    with h5py.File(path) as root:
        root.visititems(look)
    assert len(seen) > 60


READ_ALL = """
import sys, warnings
import h5py, xarray
warnings.simplefilter("error")
path, engine = sys.argv[1:]
with h5py.File(path) as root:
    every = []
    root.visit(every.append)
    groups = [name for name in every if isinstance(root[name], h5py.Group)]
for name in groups:
    with xarray.open_dataset(path, engine=engine, group=name) as found:
        found.load()
        print(name, *sorted(f"{axis}={size}" for axis, size in found.sizes.items()))
        assert sorted(found.coords) == sorted(found.sizes), name
with xarray.open_datatree(path, engine=engine) as tree:
    assert len(list(tree.subtree)) == len(groups) + 1
"""


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
def test_xarray_opens_every_group_with_its_axes(engine: str, path: Path) -> None:
    """In a process of its own: a file that the netCDF library does not take kills it."""
    command = [sys.executable, "-W", "ignore", "-c", READ_ALL, str(path), engine]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert "phony" not in ran.stdout
    lines = ran.stdout.splitlines()
    assert {"results/table name=3", "specimen/bundle wire=2 wire_types=2 xy=2"} <= set(lines)
    assert "curve time=600" in lines


LOAD = """
d = load("result.h5");
t = d.results.table;
names = cellstr(t.name);
printf("%s=%.6g [%.6g, %.6g] %s|", names{1}, t.value(1), t.lower(1), t.upper(1), t.unit(1, 1));
printf("%d|", isnan(t.value));
printf("%s|", strtrim(d.quality.message(3, :)));
printf("%.6g|", d.budgets.share);
printf("%d %d|", size(d.curve.force), size(d.shape.positions));
printf("%s", strjoin(fieldnames(d)', " "));
"""


@needs_octave
def test_octave_loads_everything(path: Path, result: TestResult) -> None:
    command = [OCTAVE or "", "--quiet", "--no-init-file", "--eval", LOAD]
    ran = subprocess.run(command, capture_output=True, check=False, cwd=path.parent)
    assert result.curve is not None
    assert result.shape is not None
    frames, points, _ = result.shape.positions.shape
    assert ran.stdout.decode().split("|") == [
        *("peak_force.1=0.62 [0.59, 0.61] N", "0", "0", "1", "Größe über 3 µm", "0.36", "0.64"),
        *(f"1 {len(result.curve.force)}", f"3 {points}"),
        f"{frames} aligned bending budgets curve quality raw results shape specimen",
    ]


def snippets(repository: Path, language: str) -> list[str]:
    page = repository / "docs" / "how-to" / "open-in-matlab-octave-python.md"
    found = re.findall(rf"^```{language}\n(.*?)^```$", page.read_text("utf-8"), re.M | re.S)
    assert found
    return found


@pytest.mark.slow
def test_the_python_of_the_page_runs(path: Path, repository: Path) -> None:
    for code in snippets(repository, "python"):
        command = [sys.executable, "-W", "error", "-c", f"{code}\nprint('done')"]
        ran = subprocess.run(command, capture_output=True, text=True, check=False, cwd=path.parent)
        assert (ran.stderr, ran.stdout[-5:]) == ("", "done\n")


@needs_octave
def test_the_octave_of_the_page_runs(path: Path, repository: Path) -> None:
    """But for its plot, which needs a screen."""
    (code,) = snippets(repository, "octave")
    table, _, _ = code.partition("plot(")
    command = [OCTAVE or "", "--quiet", "--no-init-file", "--eval", table]
    ran = subprocess.run(command, capture_output=True, text=True, check=False, cwd=path.parent)
    assert ran.stdout.splitlines()[0].split() == [
        *("peak_force.1", "0.62", "N", "95", "%:", "0.59", "to", "0.61")
    ]
    assert "NaN" in ran.stdout.splitlines()[2]
