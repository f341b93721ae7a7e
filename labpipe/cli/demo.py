"""``labpipe demo``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from shutil import copyfile

from labpipe.campaign.executors import default_jobs
from labpipe.campaign.reporting import ReportOptions, report_tests
from labpipe.campaign.workers import run_jobs
from labpipe.cli.calibrate import calibration_table
from labpipe.cli.harness import harness_table
from labpipe.cli.process import headline, process_all, table
from labpipe.cli.report import status_of
from labpipe.cli.terminal import from_here
from labpipe.mechanics.studies.calibration_study import MODEL_FILE, calibrate_tests
from labpipe.mechanics.studies.harness_section import DEFAULT_SHEET
from labpipe.mechanics.studies.harness_solution import FollowedHarness
from labpipe.mechanics.studies.harness_study import follow_harness
from labpipe.process.output_paths import find_tests
from labpipe.process.run import Processed
from labpipe.protocol.load import find_shipped_folder, load_test_sheet
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.records.result import Status
from labpipe.virtual_lab import (
    SMALL_HARNESS,
    Campaign,
    ChosenTests,
    TensileCampaign,
    WireCampaign,
    simulate_campaigns,
    write_wire_sheet,
)

WIRES, ONE_OF_EACH, LINES = "wires", "one-of-each", "lines"
CAMPAIGNS: Mapping[str, Sequence[Campaign]] = {
    WIRES: (WireCampaign(cycles=2, fps=25.0),),
    "tensile": (TensileCampaign(),),
    "harness": SMALL_HARNESS,
}
"""Campaigns of the full demo by folder name."""
FIRST_LOOK: Sequence[Campaign] = (
    ChosenTests(CAMPAIGNS[WIRES], ("A2-085-1",)),
    ChosenTests(
        CAMPAIGNS["tensile"], ("CT-10-slit-2", "twist-tube-1a", "pet-tape-1", "stiff-bar-1")
    ),
    ChosenTests(CAMPAIGNS["harness"], ("TWB-B2-19-PVC-1", "CWB-2c-1")),
)
"""A test of each kind: those in the reference of results."""
PLAN = "version: 1\nwire: A2   # wire to calibrate; tests of other wires are predicted\n"
SHEET_WORDS = "{wire: A2, sheet: wires.xlsx}"
CALIBRATED_WORDS = "{wire: A2, sheet: wires.xlsx, calibration: calibration.json}"
"""Section of an example, and its replacement with the calibrated wire."""
_MAIN_FIGURES = ("stiffness-lines", "wire-shapes", "force-displacement")
"""Figures to look at first; the first of these that a test has is listed."""
_NEXT = """
next:
  labpipe inspect {export}
                            show what an export contains; then try your own
  labpipe new FOLDER        write the test sheet for a folder with your exports
  labpipe process FOLDER    results with intervals, quality notes, figures
  labpipe demo --full       99 tests, a calibration and four harness lines; takes minutes"""


def run(options: argparse.Namespace) -> int:
    """Make synthetic tests in vendor formats, process and report them, and list the files."""
    options.jobs = options.jobs or default_jobs()
    raw, out = options.folder / "raw" / "demo", options.folder / "processed" / "demo"
    if options.full:
        return _whole_campaigns(raw, out, options)
    return _one_of_each(raw / ONE_OF_EACH, out / ONE_OF_EACH, options)


def _one_of_each(raw: Path, out: Path, options: argparse.Namespace) -> int:
    """Process and report one test of each kind."""
    print(f"making a synthetic test of each kind in {raw}", file=sys.stderr)
    folders_by_kind = run_jobs(
        [partial(simulate_campaigns, [campaign], raw) for campaign in FIRST_LOOK], jobs=options.jobs
    )
    tests = [folder / SHEET_NAME for folders in folders_by_kind for folder in folders]
    processed, refused = _process(tests, out, tests, options)
    if not processed:
        return 2  # messages are printed already
    first, *others = processed
    print("\n".join((table(first), "", *map(headline, others))))
    page, status = _report(out, write_wire_sheet(raw))
    main_figures = [
        next(path for name in _MAIN_FIGURES for path in test.figures if path.name == f"{name}.svg")
        for test in processed
        if test.figures
    ]
    _print_files("open in a browser, the report first", (page, *main_figures))
    print(_NEXT.format(export=from_here(raw / first.result.test / first.result.inputs[0].file)))
    return _status(processed, refused, status)


def _whole_campaigns(raw: Path, out: Path, options: argparse.Namespace) -> int:
    """Process three campaigns, report each, calibrate, and compute four harness lines."""
    print(f"making synthetic campaigns in {raw}", file=sys.stderr)
    run_jobs(
        [partial(simulate_campaigns, campaign, raw / name) for name, campaign in CAMPAIGNS.items()],
        jobs=options.jobs,
    )
    processed, refused = list[Processed](), 0
    for name in CAMPAIGNS:
        tests = find_tests([raw / name])
        first_of_type: dict[str, Path] = {}
        for test in tests:
            first_of_type.setdefault(load_test_sheet(test).specimen.type, test)
        done, n_refused = _process(tests, out / name, first_of_type.values(), options)
        processed += done
        refused += n_refused
    firsts: dict[str, Processed] = {}  # of each kind
    for done_test in processed:
        firsts.setdefault(done_test.result.protocol, done_test)
    lines = (
        f"\n{table(test)}\n" if test is firsts[test.result.protocol] else headline(test)
        for test in processed
    )
    print("\n".join(lines).replace("\n\n\n", "\n\n").strip())
    wires = write_wire_sheet(raw / WIRES)
    print(f"reporting {', '.join(CAMPAIGNS)}", file=sys.stderr)
    reports = run_jobs(
        [partial(_report, out / name, wires) for name in CAMPAIGNS], jobs=options.jobs
    )
    plan = raw / WIRES / "plan.yaml"
    plan.write_text(PLAN, encoding="utf-8")
    is_drawn = not options.no_figures
    calibrated = calibrate_tests([out / WIRES], wires=wires, plan=plan, figures=is_drawn)
    print(f"\n{calibration_table(calibrated)}")
    harnesses = _follow_harnesses(raw / LINES, out / LINES, calibrated.folder / MODEL_FILE, options)
    print("\n".join(f"\n{harness_table(harness)}" for harness in harnesses))
    _print_files("reports, one page each", [page for page, _ in reports])
    of_lines = [path for harness in harnesses for path in harness.files]
    drawn = [path for first in firsts.values() for path in first.figures]
    drawn = [path for path in (*drawn, *calibrated.files, *of_lines) if path.suffix == ".svg"]
    if drawn:
        _print_files("figures of a test of each kind, the calibration and the lines", drawn)
    is_failed = [int(harness.status is Status.FAILED) for harness in harnesses]
    return _status(processed, refused, *(status for _, status in reports), *is_failed)


def _process(
    tests: Sequence[Path], out: Path, drawn: Collection[Path], options: argparse.Namespace
) -> tuple[list[Processed], int]:
    """Process tests, and draw the figures of some."""
    return process_all(
        [*tests],
        out=out,
        figures=lambda test: not options.no_figures and test in drawn,
        png=options.png,
        jobs=options.jobs,
    )


def _status(processed: Sequence[Processed], refused: int, *reports: int) -> int:
    """Return the exit status: 2 if a test was refused, 1 if a result failed, else the reports'."""
    failed = int(any(test.n_failed for test in processed))
    return 2 if refused else max(failed, *reports)


def _report(folder: Path, wires: Path) -> tuple[Path, int]:
    """Report a campaign; return its page and the exit status."""
    title = f"Synthetic demo campaign: {folder.name}"
    reported = report_tests([folder], options=ReportOptions(title, wires=wires))
    return reported.files[0], status_of(reported)


def _follow_harnesses(
    raw: Path, out: Path, calibration: Path, options: argparse.Namespace
) -> list[FollowedHarness]:
    """Compute the example lines; those of the calibrated wire use its law."""
    examples = find_shipped_folder("examples")
    raw.mkdir(parents=True, exist_ok=True)
    copyfile(examples / DEFAULT_SHEET, raw / DEFAULT_SHEET)
    copyfile(calibration, raw / calibration.name)
    done = []
    for example in sorted(examples.glob("harness-*.yaml")):
        file = raw / example.name
        text = example.read_text(encoding="utf-8")
        file.write_text(text.replace(SHEET_WORDS, CALIBRATED_WORDS), encoding="utf-8")
        print(f"computing {file.stem}", file=sys.stderr)
        figures = not options.no_figures
        done.append(follow_harness(file, out=out / file.stem, figures=figures, png=options.png))
    return done


def _print_files(heading: str, paths: Iterable[Path]) -> None:
    print(f"\n{heading}:")
    print("\n".join(f"  {from_here(path)}" for path in paths))
