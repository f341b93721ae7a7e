"""``labpipe demo``: make synthetic tests in vendor formats, and process and report them."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from shutil import copyfile

from labpipe.campaign.executors import choose_default_jobs
from labpipe.campaign.reporting import ReportOptions, report_tests
from labpipe.campaign.workers import run_calls
from labpipe.cli import main
from labpipe.cli.process import format_headline, format_test, process_all
from labpipe.cli.report import print_left_out_tests
from labpipe.cli.terminal import shorten_path
from labpipe.mechanics.studies.calibration_study import MODEL_FILE
from labpipe.mechanics.studies.harness_line import DEFAULT_SHEET
from labpipe.process.output_paths import find_tests
from labpipe.protocol.load import find_shipped_folder, load_test_sheet
from labpipe.protocol.sheet_grammar import SHEET_NAME
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
"""Names of folders of the demo, for wire tests, one test of each kind, and harness lines."""
CAMPAIGNS: Mapping[str, Sequence[Campaign]] = {
    WIRES: (WireCampaign(cycles=2, fps=25.0),),
    "tensile": (TensileCampaign(),),
    "harness": SMALL_HARNESS,
}
"""Campaigns of the full demo, keyed by the name of their folder."""
DEMO_TESTS: Sequence[Campaign] = (
    ChosenTests(CAMPAIGNS[WIRES], ("A2-085-1",)),
    ChosenTests(
        CAMPAIGNS["tensile"], ("CT-10-slit-2", "twist-tube-1a", "pet-tape-1", "stiff-bar-1")
    ),
    ChosenTests(CAMPAIGNS["harness"], ("TWB-B2-19-PVC-1", "CWB-2c-1")),
)
"""One test of each kind; the reference page of results shows their results."""
CALIBRATION_PLAN = (
    "version: 1\nwire: A2   # wire to calibrate; tests of other wires are predicted\n"
)
"""Calibration plan of the full demo."""
WIRE_SECTION = "{wire: A2, sheet: wires.xlsx}"
"""Section of an example harness to which a calibration is added."""
_MAIN_FIGURES = ("stiffness-lines", "wire-shapes", "force-displacement")
"""Names of main figures in order of priority; the first one that a test has is listed."""
_NEXT_COMMANDS = """
next:
  labpipe inspect {export}
                            show what an export contains; then try your own
  labpipe new FOLDER        write the test sheet for a folder with your exports
  labpipe process FOLDER    results with intervals, quality notes, figures
  labpipe demo --full       99 tests, a calibration and four harness lines; takes minutes"""


def run(options: argparse.Namespace) -> int:
    """Make synthetic tests in vendor formats, process and report them, and list the files."""
    options.jobs = options.jobs or choose_default_jobs()
    raw, out = options.folder / "raw" / "demo", options.folder / "processed" / "demo"
    if options.full:
        return _run_full_demo(raw, out, options)
    return _run_short_demo(raw / ONE_OF_EACH, out / ONE_OF_EACH, options)


def _run_short_demo(raw: Path, out: Path, options: argparse.Namespace) -> int:
    """Make, process and report one test of each kind."""
    print(f"making a synthetic test of each kind in {raw}", file=sys.stderr)
    folders_by_kind = run_calls(
        [partial(simulate_campaigns, [campaign], raw) for campaign in DEMO_TESTS], jobs=options.jobs
    )
    sheets = [folder / SHEET_NAME for folders in folders_by_kind for folder in folders]
    processed_tests, n_refused = process_all(sheets, options, out=out)
    if not processed_tests:
        return 2  # `process_all` has printed the reasons
    first_test, *other_tests = processed_tests
    print("\n".join((format_test(first_test), "", *map(format_headline, other_tests))))
    title, wire_sheet = f"Synthetic demo campaign: {out.name}", write_wire_sheet(raw)
    report = report_tests([out], options=ReportOptions(title, wires=wire_sheet))
    main_figures = [
        next(path for name in _MAIN_FIGURES for path in test.figures if path.name == f"{name}.svg")
        for test in processed_tests
        if test.figures
    ]
    print("\nopen in a browser, the report first:")
    print("\n".join(f"  {shorten_path(path)}" for path in (report.files[0], *main_figures)))
    export = raw / first_test.result.test / first_test.result.inputs[0].file
    print(_NEXT_COMMANDS.format(export=shorten_path(export)))
    has_failures = any(test.n_failed for test in processed_tests)
    return 2 if n_refused else max(int(has_failures), print_left_out_tests(report))


def _run_full_demo(raw: Path, out: Path, options: argparse.Namespace) -> int:
    """Make three campaigns, and run the commands that process, report, calibrate and model them."""
    print(f"making synthetic campaigns in {raw}", file=sys.stderr)
    entries = CAMPAIGNS.items()
    calls = [partial(simulate_campaigns, campaigns, raw / name) for name, campaigns in entries]
    run_calls(calls, jobs=options.jobs)
    wire_sheet, plan_file = write_wire_sheet(raw / WIRES), raw / WIRES / "plan.yaml"
    plan_file.write_text(CALIBRATION_PLAN, encoding="utf-8")
    figure_options = ["--no-figures"] * options.no_figures + ["--png"] * options.png
    job_options = ["--jobs", options.jobs]
    model_file = out / WIRES / "calibration" / MODEL_FILE
    harness_files = _write_harness_files(raw / LINES, model_file)
    commands: list[list[object]] = []
    for name in CAMPAIGNS:
        folders_by_type: dict[str, Path] = {}
        for sheet in find_tests([raw / name]):
            folders_by_type.setdefault(load_test_sheet(sheet).specimen.type, sheet.parent)
        title = f"Synthetic demo campaign: {name}"
        commands += [
            ["process", *folders_by_type.values(), *figure_options, *job_options],
            ["campaign", "run", raw / name, "--no-figures", *job_options],
            ["report", out / name, "--title", title, "--wire", wire_sheet],
        ]
    commands += [
        ["calibrate", out / WIRES, "--wire", wire_sheet, "--plan", plan_file, *figure_options],
        ["harness", *harness_files, "--out", out / LINES, *figure_options],
    ]
    statuses = []
    for command in commands:
        arguments = [str(shorten_path(arg) if isinstance(arg, Path) else arg) for arg in command]
        print(f"\n$ labpipe {shlex.join(arguments)}", flush=True)
        statuses.append(main(arguments))
    return max(statuses)


def _write_harness_files(folder: Path, calibration: Path) -> list[Path]:
    """Copy the example harnesses; those of the calibrated wire use its calibration."""
    examples = find_shipped_folder("examples")
    folder.mkdir(parents=True, exist_ok=True)
    copyfile(examples / DEFAULT_SHEET, folder / DEFAULT_SHEET)
    section = f"{WIRE_SECTION[:-1]}, calibration: {os.path.relpath(calibration, folder)}}}"
    files = []
    for example in sorted(examples.glob("harness-*.yaml")):
        text = example.read_text(encoding="utf-8").replace(WIRE_SECTION, section)
        files.append(folder / example.name)
        files[-1].write_text(text, encoding="utf-8")
    return files
