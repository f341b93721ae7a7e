"""Use of each file below the folder of exports of a campaign."""

from __future__ import annotations

from labpipe.campaign.catalog import FAILED, PENDING, RUNNING, STALE
from labpipe.campaign.pairing import list_candidates, plan_of
from labpipe.campaign.refreshing import CatalogSync, Overview
from labpipe.errors import LabpipeError
from labpipe.protocol.campaign_plan import PLAN_NAME

USED, WAITING, UNKNOWN = "used", "waiting", "unknown"


def account_for_files(sync: CatalogSync, overview: Overview) -> dict[str, list[str]]:
    """Determine the use of each file.

    Parameters
    ----------
    sync : of the catalog
    overview : of the campaign

    Returns
    -------
    Sorted files below the campaign: ``used`` (in results), ``waiting`` (of a test to process),
    ``failed`` (of a failed test) and ``unknown`` (in no test sheet).
    """
    files_by_use: dict[str, list[str]] = {USED: [], WAITING: [], FAILED: [], UNKNOWN: []}
    owner: dict[str, str] = {}
    for folder, sheet in overview.raw.sheets.items():
        state = overview.state_of(folder)
        use = WAITING if state in {PENDING, STALE, RUNNING} else USED
        use = FAILED if state == FAILED else use
        for name in sync.files_of(folder, sheet):
            owner[f"{folder}/{name}" if folder else name] = use
    owner |= {file: use for file, use in _by_plan(sync).items() if file not in owner}
    for file in overview.raw.files:
        files_by_use[owner.get(file, UNKNOWN)].append(file)
    return {use: sorted(files) for use, files in files_by_use.items()}


def _by_plan(sync: CatalogSync) -> dict[str, str]:
    """Return the use of the campaign YAML and of the exports that it pairs."""
    raw = sync.campaign.raw
    if not (raw / PLAN_NAME).is_file():
        return {}
    use_by_file = {PLAN_NAME: USED}
    try:
        listed = list_candidates(raw, plan_of(raw))
    except (LabpipeError, OSError):  # `labpipe check` reports the fault
        return use_by_file
    for candidate in listed.candidates:
        if candidate.by_role or not candidate.sheet.exists():
            use = USED if candidate.sheet.exists() else WAITING
            files = [path for path in candidate.files.values() if path.is_relative_to(raw)]
            use_by_file |= {path.relative_to(raw).as_posix(): use for path in files}
    return use_by_file
