from __future__ import annotations

import html
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
from openpyxl import load_workbook

from labpipe.errors import StoreError
from labpipe.records.group import BundlePlace, Campaign
from labpipe.records.quality import QualityNote, Severity
from labpipe.report.lab_report import Extras, write_report
from labpipe.report.wording import printable
from tests.builders.bundle_campaigns import bundle_campaign, bundle_of, three_of
from tests.builders.campaigns import build_campaign, build_group, build_sample


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Path]]:
    folder = tmp_path_factory.mktemp("report")
    return folder, write_report(build_campaign(), folder)


def test_files(written: tuple[Path, list[Path]]) -> None:
    folder, files = written
    assert [path.name for path in files] == ["report.html", "tables.xlsx"]
    assert {path for path in folder.rglob("*") if path.is_file()} == set(files)


@pytest.mark.slow
def test_figures_are_files_on_request(tmp_path: Path) -> None:
    files = write_report(build_campaign(), tmp_path, Extras(formats=("svg",)))
    assert files[2].relative_to(tmp_path).as_posix() == "figures/twist-tube-10-curves.svg"
    assert {path.suffix for path in files[2:]} == {".svg"}
    assert {path for path in tmp_path.rglob("*") if path.is_file()} == set(files)


def test_pages_of_tests_stand_beside_it(tmp_path: Path) -> None:
    extras = Extras(test_pages={"tests/tt-s1a.html": "<p>one</p>"})
    files = write_report(build_campaign(), tmp_path, extras)
    assert files[2].read_text(encoding="utf-8") == "<p>one</p>"
    assert '<a class="test-page" href="tests/tt-s1a.html">' in files[0].read_text(encoding="utf-8")


@pytest.mark.parametrize("samples", [6, 15])
def test_a_page_is_as_small_as_it_should_be(samples: int, tmp_path: Path) -> None:
    """At most 0.3 MB and 3 kB a test, as few groups of 60 tests show."""
    groups = 60 // samples
    shown = 1 if samples > 3 else 3  # groups that are made; the others are as large
    made = [
        build_group(
            f"type {number}",
            [build_sample(f"s{n % 3}", str(n), cycles=3, slips=1, seed=n) for n in range(samples)],
        )
        for number in range(shown)
    ]
    page = write_report(Campaign("Synthetic", tuple(made)), tmp_path)[0]
    empty = write_report(Campaign("Synthetic", ()), tmp_path / "empty")[0]
    own = (page.stat().st_size - empty.stat().st_size) / shown
    assert groups * own + empty.stat().st_size < 0.3e6 + 60 * 3e3


def test_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("")
    with pytest.raises(StoreError, match=r"x: expected a folder that a report can be written to, "):
        write_report(Campaign("Synthetic", ()), tmp_path / "x")


@pytest.mark.slow
def test_figures_over_groups_are_saved(tmp_path: Path) -> None:
    bundles = [bundle_of("7 B1"), bundle_of("7 B2")]
    campaign = bundle_campaign([each for bundle in bundles for each in three_of(bundle)])
    place = BundlePlace(campaign.groups[0].name, "t-1", 0.006, None, 0.001, 0.004, 0.1, (0.1, 0.1))
    extras = Extras(formats=("svg", "pdf"))
    files = write_report(replace(campaign, places=(place,)), tmp_path, extras)
    names = {file.name for file in files}
    assert {
        "difference-wire-7-wires-half-lap-pvc-length-114-3-mm.svg",
        "between-slipping-and-sticking.pdf",
    } <= names
    assert len({name.rpartition(".")[0] for name in names if name.endswith(".svg")}) == 8


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["$x_1$ <b> & 'q'", "\\frac{$", "A\x07\x1b\x002\n\ud800\ufffe", "x" * 300, "\U0001f600"]
)
def test_any_name_is_reported(name: str, tmp_path: Path) -> None:
    """As channels and exports may be called, or a result file of another program says."""
    samples = [build_sample(name, letter, slips=1, seed=seed) for seed, letter in enumerate("abc")]
    specimen = replace(samples[0].specimen, type=name, sample=name, labels={"cured": name})
    note = QualityNote("code", Severity.WARNING, name, f"about {name}")
    odd = [
        replace(each, test=name + each.test, specimen=specimen, quality=(note,)) for each in samples
    ]
    groups = (build_group(name, odd), build_group("plain", samples))
    campaign = replace(build_campaign(), title=name, groups=groups, differences=())
    files = write_report(campaign, tmp_path, Extras(formats=("svg",)))
    page = files[0].read_text(encoding="utf-8")
    assert html.escape(printable(name)).replace("&#x27;", "&#39;") in page
    for drawing in tmp_path.rglob("*.svg"):
        ElementTree.fromstring(drawing.read_bytes())
    book = load_workbook(tmp_path / "tables.xlsx")
    assert printable(name) in {row[0] for row in book["means"].iter_rows(values_only=True)}
