"""``labpipe serve``: show a report in the browser and save decisions."""

from __future__ import annotations

import argparse
import webbrowser
from pathlib import Path

from labpipe.campaign.campaign_files import find_campaign_name
from labpipe.campaign.reporting import ReportOptions, report_tests
from labpipe.campaign.serving import REPORT_FOLDER, ReportServer, Site
from labpipe.cli.report import parse_report_options
from labpipe.cli.terminal import show_completion
from labpipe.process.output_paths import find_results, find_shared_folder
from labpipe.report.lab_report import PAGE_FILE


def run(options: argparse.Namespace) -> int:
    """Serve a report until Ctrl+C is pressed; write the report first if it does not exist."""
    folder = find_shared_folder(find_results(options.paths))
    report_folder = folder / REPORT_FOLDER if options.out is None else options.out
    name = find_campaign_name(folder)
    site = Site(folder, name, report_folder, lambda: _make_report(options, report_folder))
    with ReportServer(site, options.port) as server:
        if not (report_folder / PAGE_FILE).is_file():
            _make_report(options, report_folder)
        print(f"{options.title or site.campaign or folder.name}: {server.report_url}")
        print("Reachable from this machine only. Press Ctrl+C to stop.", flush=True)
        if not options.no_browser:
            webbrowser.open(server.report_url)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print()
    return 0


def _make_report(options: argparse.Namespace, folder: Path) -> None:
    """Write the report; missing options are those of the earlier report in the folder, if any."""
    files = find_results(options.paths)
    report_options = parse_report_options(options).fill_from(ReportOptions.read(folder))
    with show_completion("test", len(files) + 1, in_pipe=False) as (_, say):
        report_tests(files, out=options.out, say=say, options=report_options)
