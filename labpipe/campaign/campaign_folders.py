"""Folders of a campaign and their content."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from labpipe.errors import StoreError, UsageError, refusal
from labpipe.process.output_paths import RESULT_FILE
from labpipe.process.run import FIGURES, SUMMARY_FILE
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.store.replace import STAGES, finish_cut_off, is_cut_off, locked, storing
from labpipe.store.summaries import FAILURE_FILE

RAW, PROCESSED = "raw", "processed"
_OUTCOME = (SUMMARY_FILE, FAILURE_FILE, RESULT_FILE)


@dataclass(frozen=True, slots=True)
class CampaignFolders:
    """A campaign: a folder of exports and a folder of results with the same name.

    Parameters
    ----------
    name : the folder below ``raw`` and ``processed``, with slashes
    raw : exports and test sheets, a folder per test; may be missing
    processed : results, a folder per test; made on first use
    """

    name: str
    raw: Path
    processed: Path


def find_campaign(folder: Path) -> CampaignFolders:
    """Find both folders of a campaign from one of them.

    Parameters
    ----------
    folder : ``.../raw/NAME`` or ``.../processed/NAME``

    Raises
    ------
    UsageError
        If it is missing, below neither, or the folder of a single test.
    """
    expected = "the folder of a campaign"
    if not folder.is_dir():
        raise _no_campaign(
            folder, expected, "a file" if folder.exists() else "nothing of that name"
        )
    start = folder.resolve()
    for above in (start, *start.parents):
        if above.name in {RAW, PROCESSED}:
            name = start.relative_to(above)
            raw, processed = (_as_typed(above.parent / top / name) for top in (RAW, PROCESSED))
            if (raw / SHEET_NAME).is_file():
                raise _no_campaign(folder, expected, "the folder of a single test")
            return CampaignFolders(name.as_posix(), raw, processed)
    raise _no_campaign(folder, "a folder below 'raw' or 'processed'", "a folder below neither")


def find_campaign_name(folder: Path) -> str:
    """Return the name of the campaign whose results are in a folder.

    Parameters
    ----------
    folder : any

    Returns
    -------
    The name; empty if the folder belongs to no campaign.
    """
    with suppress(UsageError):
        return find_campaign(folder).name
    return ""


def _as_typed(path: Path) -> Path:
    """Return a path relative to the working folder if it is below it, for messages in files."""
    current = Path.cwd().resolve()
    return path.relative_to(current) if path.is_relative_to(current) else path


def _no_campaign(folder: Path, expected: str, found: str) -> UsageError:
    return UsageError.about("campaign.no_campaign", folder, expected=expected, found=found)


@dataclass(slots=True)
class RawContent:
    """Content of the folder of exports.

    Parameters
    ----------
    sheets : test sheet by test, named by its folder below the campaign
    files : all files except hidden ones, below the campaign, with slashes
    refused : messages on what cannot be read
    """

    sheets: dict[str, Path] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)


def list_raw(campaign: CampaignFolders) -> RawContent:
    """List tests and files of a campaign, without opening any.

    Parameters
    ----------
    campaign : if its folder of exports is missing, the lists are empty
    """
    listing = RawContent()
    for label, place, files, _ in _walk(campaign.raw, listing.refused):
        listing.files += [f"{label}/{name}" if label else name for name in files]
        if SHEET_NAME not in files:
            continue
        sheet = Path(place, SHEET_NAME)
        if sheet.is_file():
            listing.sheets[label] = sheet
        else:
            listing.refused.append(str(StoreError.about("campaign.odd_sheet", sheet)))
    return listing


@dataclass(frozen=True, slots=True)
class OutcomeFiles:
    """Files of the outcome of a test.

    Parameters
    ----------
    folder : of the results
    marks : size, time and inode of each file as text; equal for unchanged files
    """

    folder: Path
    marks: str

    @property
    def has_results(self) -> bool:
        """Return whether there are complete results."""
        return f"{SUMMARY_FILE}:" in self.marks and f"{RESULT_FILE}:" in self.marks

    @property
    def has_failure(self) -> bool:
        """Return whether the last attempt failed."""
        return f"{FAILURE_FILE}:" in self.marks


def list_processed(campaign: CampaignFolders) -> dict[str, OutcomeFiles]:
    """List the outcomes of a campaign by test, without opening any.

    Parameters
    ----------
    campaign : its folder of results may be missing

    Returns
    -------
    Outcome files of each folder that has any.
    """
    outcomes = {}
    for label, place, files, hidden in _walk(campaign.processed, [], skipped=FIGURES):
        if hidden & {*STAGES}:
            outcome = find_outcome(campaign, label)
        else:
            outcome = OutcomeFiles(Path(place), _marks(place, files))
        if outcome.marks:
            outcomes[label] = outcome
    return outcomes


def find_outcome(campaign: CampaignFolders, test: str) -> OutcomeFiles:
    """Find the outcome of one test.

    Parameters
    ----------
    campaign : of the test
    test : its folder below the campaign
    """
    folder = campaign.processed / test
    if is_cut_off(folder):  # by a killed process, or another process works there
        with suppress(StoreError), locked(folder), storing(folder):
            finish_cut_off(folder)
    files = [name for name in _OUTCOME if (folder / name).is_file()]
    return OutcomeFiles(folder, _marks(str(folder), files))


def _marks(place: str, files: list[str]) -> str:
    marks = []
    for name in _OUTCOME:
        if name not in files:
            continue
        with suppress(OSError):
            about = os.stat(f"{place}/{name}")  # noqa: PTH116  Path is slow for ten thousand files
            marks.append(f"{name}:{about.st_size}:{about.st_mtime_ns}:{about.st_ino}")
    return " ".join(marks)


def _walk(
    top: Path, refused: list[str], *, skipped: str = ""
) -> Iterator[tuple[str, str, list[str], set[str]]]:
    """Yield folders below a folder, without hidden ones and links: files and hidden names."""
    pending = [("", str(top))]
    while pending:
        label, place = pending.pop()
        try:
            with os.scandir(place) as entries:
                every = list(entries)
            seen = [entry for entry in every if not entry.name.startswith(".")]
            refused += [_name_error(entry.path) for entry in seen if not _is_text(entry.name)]
            seen = [entry for entry in seen if _is_text(entry.name)]
            folders = {entry.name for entry in seen if entry.is_dir(follow_symlinks=False)}
        except FileNotFoundError:
            continue
        except OSError as error:
            refused.append(refusal(error))
            continue
        files = [entry.name for entry in seen if entry.name not in folders]
        yield label, place, files, {entry.name for entry in every if entry.name.startswith(".")}
        pending += [
            (f"{label}/{name}" if label else name, f"{place}/{name}")
            for name in sorted(folders, reverse=True)
            if name != skipped
        ]


def _is_text(name: str) -> bool:
    """Return whether a name is valid text: on Linux it may be any bytes."""
    return name.isascii() or not any("\ud800" <= sign <= "\udfff" for sign in name)


def _name_error(path: str) -> str:
    printable_path = path.encode("utf-8", "backslashreplace").decode()
    return str(StoreError.about("campaign.odd_name", printable_path))
