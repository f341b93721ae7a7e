"""What every file below a campaign's folder of exports is for."""

from __future__ import annotations

from labpipe.campaign.catalog import FAILED, PENDING, RUNNING, STALE
from labpipe.campaign.pairing import list_candidates, plan_of
from labpipe.campaign.refreshing import CatalogSync, Overview
from labpipe.errors import LabpipeError
from labpipe.protocol.campaign_plan import PLAN_NAME

USED, WAITING, UNKNOWN = "used", "waiting", "unknown"


def account_for_files(keeper: CatalogSync, overview: Overview) -> dict[str, list[str]]:
    """Say what became of every file.

    Parameters
    ----------
    keeper : of the catalog
    overview : of the campaign

    Returns
    -------
    Files below the campaign, sorted, by ``used`` (in results), ``waiting`` (of a test that is to
    be processed), ``failed`` (of a test that failed) and ``unknown`` (no test sheet names them).
    """
    found: dict[str, list[str]] = {USED: [], WAITING: [], FAILED: [], UNKNOWN: []}
    owner: dict[str, str] = {}
    for folder, sheet in overview.raw.sheets.items():
        state = overview.state_of(folder)
        became = WAITING if state in {PENDING, STALE, RUNNING} else USED
        became = FAILED if state == FAILED else became
        for name in keeper.files_of(folder, sheet):
            owner[f"{folder}/{name}" if folder else name] = became
    owner |= {file: became for file, became in _by_plan(keeper).items() if file not in owner}
    for file in overview.raw.files:
        found[owner.get(file, UNKNOWN)].append(file)
    return {became: sorted(files) for became, files in found.items()}


def _by_plan(keeper: CatalogSync) -> dict[str, str]:
    """The campaign YAML, and exports that it pairs: used where their test has a sheet."""
    raw = keeper.campaign.raw
    if not (raw / PLAN_NAME).is_file():
        return {}
    found = {PLAN_NAME: USED}
    try:
        listed = list_candidates(raw, plan_of(raw))
    except (LabpipeError, OSError):  # `labpipe check` says what is wrong with it
        return found
    for candidate in listed.candidates:
        if candidate.by_role or not candidate.sheet.exists():
            became = USED if candidate.sheet.exists() else WAITING
            files = [path for path in candidate.files.values() if path.is_relative_to(raw)]
            found |= {path.relative_to(raw).as_posix(): became for path in files}
    return found
