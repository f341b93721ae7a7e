from __future__ import annotations

import html
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
from openpyxl import load_workbook

from labpipe.errors import StoreError
from labpipe.records.group import BundlePlace, Campaign
from labpipe.records.quality import QualityNote, Severity
from labpipe.report.lab_report import write_report
from labpipe.report.wording import printable
from tests.builders.bundle_campaigns import bundle_campaign, bundle_of, three_of
from tests.builders.campaigns import build_campaign, build_group, build_sample


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Path]]:
    folder = tmp_path_factory.mktemp("report")
    return folder, write_report(build_campaign(), folder)


def test_files(written: tuple[Path, list[Path]]) -> None:
    folder, files = written
    assert [path.relative_to(folder).as_posix() for path in files[:3]] == [
        "report.html", "tables.xlsx", "figures/twist-tube-10-curves.svg",
    ]  # fmt: skip
    assert {path for path in folder.rglob("*") if path.is_file()} == set(files)
    kinds = Counter(path.suffix for path in files[2:])
    assert kinds == {".svg": 8, ".png": 8, ".pdf": 8}


def test_every_figure_stands_in_the_page_with_ids_of_its_own(
    written: tuple[Path, list[Path]],
) -> None:
    page = written[1][0].read_text(encoding="utf-8")
    assert page.count('role="img" aria-label="') == page.count("<svg") == 8
    ids = re.findall(r' id="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r"url\(#([^)]+)\)", page)) <= set(ids)
    assert not re.findall(r"https?://(?!www\.w3\.org/)", page)


@pytest.mark.parametrize("samples", [1, 15])
def test_page_of_thirty_tests_is_below_a_megabyte(samples: int, tmp_path: Path) -> None:
    groups = 30 // samples
    shown = 1 if samples > 1 else 3  # groups that are drawn; the others are as large
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
    assert groups * own + empty.stat().st_size < 1e6


def test_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("")
    with pytest.raises(StoreError, match=r"x: expected a folder that a report can be written to, "):
        write_report(Campaign("Synthetic", ()), tmp_path / "x")


def test_figures_over_groups_are_saved_and_stand_on_the_page(tmp_path: Path) -> None:
    bundles = [bundle_of("7 B1"), bundle_of("7 B2")]
    campaign = bundle_campaign([each for bundle in bundles for each in three_of(bundle)])
    place = BundlePlace(campaign.groups[0].name, "t-1", 0.006, None, 0.001, 0.004, 0.1, (0.1, 0.1))
    files = write_report(replace(campaign, places=(place,)), tmp_path)
    names = {file.name for file in files}
    assert {
        "difference-wire-7-wires-half-lap-pvc-length-114-3-mm.svg",
        "between-slipping-and-sticking.pdf",
    } <= names
    page = files[0].read_text(encoding="utf-8")
    assert page.count("<svg") == 2 * 3 + 2
    assert len(files) == 2 + 3 * page.count("<svg")


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
    files = write_report(campaign, tmp_path)
    page = files[0].read_text(encoding="utf-8")
    assert html.escape(printable(name)).replace("&#x27;", "&#39;") in page
    for drawing in tmp_path.rglob("*.svg"):
        ElementTree.fromstring(drawing.read_bytes())
    book = load_workbook(tmp_path / "tables.xlsx")
    assert printable(name) in {row[0] for row in book["means"].iter_rows(values_only=True)}
