"""One recording counted once: copies of a test under another name."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from pathlib import Path

from labpipe.errors import complaint
from labpipe.protocol.schema import Protocol
from labpipe.records.result import TestResult


def recording_of(result: TestResult, protocol: Protocol) -> Hashable:
    """Say which recording of which specimen a test was made of.

    Parameters
    ----------
    result : with its inputs
    protocol : resolved

    Returns
    -------
    Equal for two tests whose exports are the same bytes and of which the same channels, markers and
    parts were taken, by one protocol. One export may hold several specimens.
    """
    exports = tuple(sorted((each.role, each.sha256) for each in result.inputs))
    taken = tuple(
        (role, source.part, *(each.channel for each in source.all_channels.values()))
        for role, source in protocol.sources.items()
    )
    markers = protocol.markers
    seen = None if markers is None else (markers.clamp, markers.along)
    return result.protocol, exports, taken, seen


def find_copies(recordings: Sequence[tuple[Path, Hashable]]) -> dict[str, str]:
    """Find tests whose recording is that of an earlier one.

    Parameters
    ----------
    recordings : file and `recording_of` of each test

    Returns
    -------
    By file, as text, why it is not to be counted.
    """
    first: dict[Hashable, Path] = {}
    copies: dict[str, str] = {}
    for file, recording in recordings:
        kept = first.setdefault(recording, file)
        if kept != file:
            copies[str(file)] = complaint(
                file,
                "",
                expected="each recording once",
                found=f"the same exports, byte for byte, as in {kept}",
                remedy="Look at `files` in both test sheets, or leave the copy out.",
            )
    return copies
