"""The documentation keeps up with the code: commands, links, pictures, YAML, names and codes."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args

import pytest

from labpipe.cli import build_parser, main
from labpipe.errors import CODES
from labpipe.protocol.load import (
    load_calibration_plan,
    load_campaign_plan,
    load_harness,
    load_test_sheet,
    parse_protocol,
    resolve_protocol,
)
from labpipe.protocol.schema import KINDS_BY_NAME
from labpipe.readers import READERS
from labpipe.records.curve import ClockFit, Curve, Shape
from labpipe.records.declarations import Step
from labpipe.records.recording import MarkerTracks, RigidBody
from tests.builders.small_tests import Lab

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.rglob("*.md"), *ROOT.glob("*/README.md")])
IMAGES = sorted((DOCS / "images").iterdir())
MAX_BYTES = 200_000


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def page(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as left:
        main(arguments)
    assert left.value.code == 0
    return capsys.readouterr().out


def commands(capsys: pytest.CaptureFixture[str]) -> list[str]:
    found = re.findall(r"^    ([a-z]+) ", said(capsys, "--help"), flags=re.MULTILINE)
    assert "process" in found
    return found


def help_of(capsys: pytest.CaptureFixture[str], command: str) -> str:
    """Help of a command, with that of its actions."""
    own = said(capsys, command, "--help")
    actions = re.findall(r"^    ([a-z]+) ", own, flags=re.MULTILINE)
    return "\n".join([own, *(said(capsys, command, action, "--help") for action in actions)])


def options(text: str) -> set[str]:
    return set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", text))


def sections(text: str) -> dict[str, str]:
    """Text below each heading of the second level, by the heading's first code span."""
    parts = re.split(r"^## ", text, flags=re.MULTILINE)[1:]
    return {
        code[1]: part for part in parts if (code := re.match(r"`([^`]+)`", part.splitlines()[0]))
    }


def fenced(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)


def test_every_command_and_option_is_documented_and_no_other(
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = page("docs/reference/command-line.md")
    reference = {heading.split()[1]: section for heading, section in sections(text).items()}
    for command in commands(capsys):
        assert f"| [`labpipe {command}`](#labpipe-{command}" in text
        has = options(help_of(capsys, command)) - {"--help"}
        assert options(reference[command]) == has, command


def calls(text: str) -> Iterator[tuple[str, str]]:
    """Command and arguments of every ``labpipe ...`` in code, lines that go on joined."""
    joined = text.replace("\\\n", " ")
    spans = re.findall(r"`labpipe ([a-z]+)([^`]*)`", joined)
    lines = re.findall(r"^\$ labpipe ([a-z]+)(.*)$", joined, flags=re.MULTILINE)
    yield from spans + lines


@pytest.mark.slow
@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_commands_in_pages_exist(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    known = commands(capsys)
    for command, arguments in calls(path.read_text(encoding="utf-8")):
        assert command in known, command
        assert options(arguments) <= options(help_of(capsys, command)), arguments


def typed_lines(text: str) -> list[list[str]]:
    """Words of each ``labpipe ...`` that a page or the first help gives to type."""
    joined = text.replace("\\\n", " ")
    shown = re.findall(r"^\$ (labpipe .*)$", joined, flags=re.MULTILINE)
    if text.startswith("usage: labpipe [-h] [--version]"):
        shown += re.findall(r"^  (labpipe (?:(?!  ).)+)(?:$|  )", text, flags=re.MULTILINE)
    return [shlex.split(line, comments=True)[1:] for line in shown]


def texts_to_type(capsys: pytest.CaptureFixture[str]) -> list[str]:
    every = [said(capsys, "--help"), *(help_of(capsys, name) for name in commands(capsys))]
    return every + [path.read_text(encoding="utf-8") for path in PAGES]


def test_what_is_to_be_typed_can_be(capsys: pytest.CaptureFixture[str]) -> None:
    lines = [words for text in texts_to_type(capsys) for words in typed_lines(text)]
    assert len(lines) > 60
    for words in lines:
        build_parser().parse_args(words)


NAMED_FILES = r"(?<![\w/.-])(?:examples|protocols|labpipe|tests|docs|benchmarks)/[\w/.-]+\.\w+"


TO_BE_WRITTEN = {
    "protocols/bundle-bending.yaml",
    "labpipe/readers/acme_txt.py",
    "tests/readers/test_acme_txt.py",
}
"""Files that a reader of a how-to writes."""


def test_files_that_are_named_exist(capsys: pytest.CaptureFixture[str]) -> None:
    """In help, README and docs, but the history."""
    for text in texts_to_type(capsys):
        if not text.startswith("# Changelog"):
            for name in re.findall(NAMED_FILES, text):
                assert (ROOT / name).exists() or name in TO_BE_WRITTEN, name


def prose(text: str) -> str:
    """A page without its fenced blocks."""
    return re.sub(r"^\s*```.*?^\s*```$", "", text, flags=re.MULTILINE | re.DOTALL)


def anchors(text: str) -> set[str]:
    """Names that the headings of a page can be linked by."""
    headings = re.findall(r"^#+ (.+)$", prose(text), flags=re.MULTILINE)
    plain = (re.sub(r"[^\w\- ]", "", heading.casefold()) for heading in headings)
    return {heading.replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_links_lead_somewhere_and_to_every_page(path: Path) -> None:
    """The navigation of the site is made of the overview. No page names a place of one machine."""
    text = path.read_text(encoding="utf-8")
    assert not re.search(r"/(tmp|work|home|Users)/|[A-Z]:\\", text)
    targets = re.findall(r"\]\(([^)\s]+)\)", prose(text))
    if path == DOCS / "README.md":
        assert {*DOCS.rglob("*.md")} - {path} <= {DOCS / target for target in targets}
    for target in targets:
        if target.startswith("https://"):
            continue
        file, _, anchor = target.partition("#")
        found = (path.parent / file).resolve() if file else path
        assert found.exists(), target
        assert found.is_relative_to(ROOT), target
        if anchor:
            assert anchor in anchors(found.read_text(encoding="utf-8")), target


@pytest.mark.parametrize("path", IMAGES, ids=name_of)
def test_pictures_are_small_and_shown_with_a_caption(path: Path) -> None:
    assert path.stat().st_size < MAX_BYTES
    # each caption says what it shows
    origin = r"(?:Synthetic data|Computed, not measured|Measured by others)\. "
    shown = rf"!\[[^\]]+\]\((?:docs|\.\.)/images/{re.escape(path.name)}\)\n\n\*{origin}"
    assert any(re.search(shown, page.read_text(encoding="utf-8")) for page in PAGES)


PLANS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "pair": ("campaign.yaml", load_campaign_plan),
    "boundaries": ("harness.yaml", load_harness),
    "comparisons": ("plan.yaml", load_calibration_plan),
}
"""By a key of the first level: the name of the file and what loads it."""


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_protocols_and_test_sheets_in_pages_are_valid(path: Path, tmp_path: Path) -> None:
    (tmp_path / "wires.xlsx").touch()
    for text in fenced(path.read_text(encoding="utf-8"), "yaml"):
        keys_above = set(re.findall(r"^(\w+):", text, flags=re.MULTILINE))
        plans = [plan for key, plan in PLANS.items() if key in keys_above]
        if plans:
            name, load = plans[0]
            whole = text if "version" in keys_above else f"version: 1\n{text}"
            (tmp_path / name).write_text(whole, encoding="utf-8")
            assert load(tmp_path / name)
        elif "version" in keys_above:
            assert parse_protocol(text, name_of(path)).results
        else:
            sheet = tmp_path / "test.yaml"
            sheet.write_text(text, encoding="utf-8")
            protocol = resolve_protocol(load_test_sheet(sheet), sheet, ROOT / "protocols")
            assert (ROOT / "protocols" / f"{protocol.name}.yaml").exists()


WITH_A_RESULT = """
import importlib, sys
import labpipe.results.cycles as module
exec(sys.argv.pop(1), vars(module))
importlib.reload(sys.modules["labpipe.results"])
from labpipe.cli import main
sys.exit(main(sys.argv[1:]))
"""


def test_the_result_of_the_how_to_can_be_added(
    pristine: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = page("docs/how-to/extend.md")
    [example] = [code for code in fenced(text, "python") if "CycleKind" in code]
    [asked] = re.findall(r"`(- \{result: end-force.*?\})`", text)
    lab = pristine.copy(tmp_path)
    monkeypatch.chdir(lab.home)
    protocol = (ROOT / "protocols" / "wire-cantilever.yaml").read_text(encoding="utf-8")
    (lab.home / "protocols").mkdir()
    (lab.home / "protocols" / "wire-cantilever.yaml").write_text(
        protocol.replace("results:\n", f"results:\n  {asked}\n"), encoding="utf-8"
    )
    command = [sys.executable, "-c", WITH_A_RESULT, example, "process", str(lab.sheet)]
    done = subprocess.run([*command, "--no-figures"], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    end, peak = (lab.results[f"{name}.1"] for name in ("end_force", "peak_force"))
    assert end["status"] == "ok"
    assert 0.9 * peak["value"] < end["value"] < peak["value"]


def result_units() -> dict[str, str]:
    """Unit of every result by name, without the cycle; where the protocol names it, the usual."""
    kinds = KINDS_BY_NAME.values()
    assert len(kinds) > 15
    named = (
        (output.format_name(kind, {"of": "<stiffness>"}), output)
        for kind in kinds
        for output in kind.outputs
    )
    return {name.partition(".")[0]: each.unit for name, each in named}


def test_every_result_is_documented_and_no_other() -> None:
    text = page("docs/reference/results.md")
    documented, units = sections(text), result_units()
    table = dict(re.findall(r"\[`([^`]+)`\]\(#\w+\) \(([^)]+)\)", text))
    assert {heading.partition(".")[0] for heading in documented} == set(units)
    for heading, section in documented.items():
        assert table[heading] == units[heading.partition(".")[0]].replace("*", " "), heading
        assert "**Example**: " in section, heading


def test_every_code_of_a_failed_test_is_documented_and_no_other() -> None:
    codes = page("docs/reference/files.md").partition("| code | why |")[2].partition("\n## ")[0]
    table = re.findall(r"^\| `(\w+)` \| (.+) \|$", codes, re.MULTILINE)
    assert dict(table) == CODES


def keys(schema: Any) -> Iterator[str]:
    """Every key that a JSON Schema knows, at any depth."""
    if isinstance(schema, dict):
        yield from schema.get("properties", {})
        for part in schema.values():
            yield from keys(part)
    if isinstance(schema, list):
        for part in schema:
            yield from keys(part)


@pytest.mark.parametrize("name", ["protocol", "test-sheet"])
def test_every_key_step_and_reader_is_named(name: str) -> None:
    known = set(keys(json.loads(page(f"docs/reference/{name}.schema.json"))))
    if name == "protocol":
        known |= {*READERS, *(kind.step for kind in get_args(get_args(Step)[0]))}
    assert len(known) > 5
    text = page(f"docs/reference/{name}.md")
    code = " ".join([*re.findall(r"`([^`]+)`", prose(text)), *fenced(text, "yaml")])
    assert known <= set(re.findall(r"[\w-]+", code))


def test_the_listing_of_the_result_file_holds_the_names_of_the_layout() -> None:
    from labpipe.store.layout import ROW_AXES, list_columns, list_datasets

    text = page("docs/reference/result-file.md")
    assert len(ROW_AXES) > 5
    for name in {name for row in ROW_AXES for name in list_columns(row)}:
        assert f"`{name}`" in text or f"/{name} " in text, name
    listing = "".join(fenced(page("docs/reference/result-file.md"), ""))
    for name in ("lines/slope", "slips/drop", "branches/start"):
        assert f"/curve/{name} " in listing
    fields = {
        "/curve/": list_datasets(Curve),
        "/shape/": list_datasets(Shape),
        "/aligned/events/": list_datasets(ClockFit),
        "/raw/markers/markers/": list_datasets(MarkerTracks),
        "/raw/markers/rigid_bodies/Clamp/": list_datasets(RigidBody),
    }
    for group, kinds in fields.items():
        for name, kind in kinds.items():
            line = rf"^{re.escape(group + name)} +\(.*\) +{re.escape(kind.unit or 's')}$"
            assert re.search(line, listing, flags=re.MULTILINE), group + name


MEASURED_ONCE = "without a command above them were measured once; no run renews them"
DECIMAL = re.compile(r"(?<![\w`-])\d+\.\d+")
STATED = ("state-uncertainties.md", "wire-sheet.md", "figures.md")
"""Pages whose tables of numbers are of standards, of inputs, and of numbered figures."""


def test_tables_of_numbers_are_made_by_a_run_or_say_that_none_renews_them() -> None:
    """Between marks, on a page whose listings are run, or under a sentence that says so."""
    for path in sorted((ROOT / "docs").rglob("*.md")):
        text = path.read_text(encoding="utf-8")
        by_hand = re.sub(r"<!--[^>]*begin -->.*?<!--[^>]*end -->", "", text, flags=re.DOTALL)
        rows = [line for line in by_hand.splitlines() if line.startswith("|")]
        numbers = [line for line in rows if len(DECIMAL.findall(line)) >= 3]
        if len(numbers) < 3 or path.name in STATED or path.name == "performance.md":
            continue
        assert MEASURED_ONCE in " ".join(text.split()), path
