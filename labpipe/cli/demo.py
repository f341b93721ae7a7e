"""``labpipe demo``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from labpipe.campaign.machine import default_jobs
from labpipe.campaign.reporting import Wanted, report_tests
from labpipe.campaign.runs import run_jobs
from labpipe.cli.calibrate import calibration_table
from labpipe.cli.process import headline, process_all, table
from labpipe.cli.report import status_of
from labpipe.cli.terminal import from_here
from labpipe.process.run import Processed
from labpipe.process.targets import find_tests
from labpipe.protocol.load import load_test_sheet
from labpipe.studies.calibration_study import Calibrated, calibrate_tests
from labpipe.virtual_lab import (
    SMALL_HARNESS,
    Campaign,
    TensileCampaign,
    WireCampaign,
    simulate_campaigns,
    write_wire_sheet,
)

WIRES = "wires"
CAMPAIGNS: Mapping[str, Sequence[Campaign]] = {
    WIRES: (WireCampaign(cycles=2, fps=25.0),),
    "tensile": (TensileCampaign(),),
    "harness": SMALL_HARNESS,
}
"""By the folder that they go to."""
PLAN = "version: 1\nwire: A2   # its tests calibrate; tests of other wires are predicted\n"


def run(options: argparse.Namespace) -> int:
    """Make synthetic campaigns in vendor formats, process, report and calibrate, and say where."""
    raw, out = options.folder / "raw" / "demo", options.folder / "processed" / "demo"
    options.jobs = options.jobs or default_jobs()
    print(f"making synthetic campaigns in {raw}", file=sys.stderr)
    run_jobs(
        [partial(simulate_campaigns, each, raw / name) for name, each in CAMPAIGNS.items()],
        jobs=options.jobs,
    )
    processed, refused = _processed(raw, out, options)
    print(_shown(processed))
    wires = write_wire_sheet(raw / WIRES)
    print(f"reports of {', '.join(CAMPAIGNS)}", file=sys.stderr)
    reports = run_jobs(
        [partial(_report, out / name, wires) for name in CAMPAIGNS], jobs=options.jobs
    )
    calibrated = _calibrated(raw / WIRES, out / WIRES, wires, is_drawn=not options.no_figures)
    print(f"\n{calibration_table(calibrated)}")
    _name_files([page for page, _ in reports], processed, calibrated)
    failed = int(any(each.n_failed for each in processed))
    return 2 if refused else max(failed, *(status for _, status in reports))


def _report(folder: Path, wires: Path) -> tuple[Path, int]:
    """Report a campaign; its page, and what became of it."""
    title = f"Synthetic demo campaign: {folder.name}"
    reported = report_tests([folder], title=title, wanted=Wanted(wires=wires))
    return reported.files[0], status_of(reported)


def _processed(raw: Path, out: Path, options: argparse.Namespace) -> tuple[list[Processed], int]:
    """Process campaign by campaign, and draw the first test of each specimen type."""
    processed, refused = [], 0
    for name in CAMPAIGNS:
        tests = find_tests([raw / name])
        drawn = set() if options.no_figures else _first_of_each_type(tests)
        done, wrong = process_all(
            tests, out=out / name, figures=drawn.__contains__, jobs=options.jobs
        )
        processed += done
        refused += wrong
    return processed, refused


def _first_of_each_type(tests: Sequence[Path]) -> set[Path]:
    firsts: dict[str, Path] = {}
    for test in tests:
        firsts.setdefault(load_test_sheet(test).specimen.type, test)
    return set(firsts.values())


def _calibrated(raw: Path, out: Path, wires: Path, *, is_drawn: bool) -> Calibrated:
    """Calibrate one of the wires, with the plan that a person would write."""
    plan = raw / "plan.yaml"
    plan.write_text(PLAN, encoding="utf-8")
    return calibrate_tests([out], wires=wires, plan=plan, figures=is_drawn)


def _name_files(
    pages: Sequence[Path], processed: Sequence[Processed], calibrated: Calibrated
) -> None:
    print("\nreports, one page each:")
    print("\n".join(f"  {from_here(page)}" for page in pages))
    firsts = [path for each in _firsts(processed) for path in each.figures]
    drawn = [path for path in (*firsts, *calibrated.files) if path.suffix == ".svg"]
    if drawn:
        print("\nfigures to look at, of the first test of each kind and of the calibration:")
        print("\n".join(f"  {from_here(path)}" for path in drawn))


def _shown(processed: Sequence[Processed]) -> str:
    """The first test of each kind in full, the others in a line."""
    firsts = _firsts(processed)
    shown = [f"\n{table(each)}\n" if each in firsts else headline(each) for each in processed]
    return "\n".join(shown).replace("\n\n\n", "\n\n").strip()


def _firsts(processed: Sequence[Processed]) -> list[Processed]:
    kinds: dict[str, Processed] = {}
    for each in processed:
        kinds.setdefault(each.result.protocol, each)
    return list(kinds.values())
