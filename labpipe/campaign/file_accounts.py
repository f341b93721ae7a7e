"""What every file below a campaign's folder of exports is for."""

from __future__ import annotations

from labpipe.campaign.catalog import FAILED, PENDING, RUNNING, STALE
from labpipe.campaign.refreshing import Keeper, Overview

USED, WAITING, UNKNOWN = "used", "waiting", "unknown"


def account_for(keeper: Keeper, overview: Overview) -> dict[str, list[str]]:
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
    for file in overview.raw.files:
        found[owner.get(file, UNKNOWN)].append(file)
    return {became: sorted(files) for became, files in found.items()}
