"""Whether files have stopped changing: exports being written, copied or locked are waited for."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

State: TypeAlias = Literal["still", "growing", "locked", "gone"]
Mark: TypeAlias = tuple[int, int]
"""Size and time of change of a file."""


@dataclass(slots=True)
class _Seen:
    """State of a file at the last look.

    Parameters
    ----------
    mark : size and time
    since : start of this state, by the clock of the watch (the clock of a drive may differ)
    moving_since : start of the last changes
    was_still : whether it was found unchanged and readable with this mark
    """

    mark: Mark
    since: float
    moving_since: float
    was_still: bool = False


class FileStability:
    """Files under repeated observation.

    Parameters
    ----------
    clock : monotonic, s
    still_for : s without a change, after which a file is still
    """

    def __init__(self, clock: Callable[[], float], still_for: float) -> None:
        self._clock, self.still_for = clock, still_for
        self._seen: dict[Path, _Seen] = {}

    def look(self, path: Path) -> State:
        """Look at a file.

        Parameters
        ----------
        path : of the file

        Returns
        -------
        ``still``: unchanged for long enough and readable; ``growing``: changed recently;
        ``locked``: unchanged, but cannot be opened; ``gone``.
        """
        now = self._clock()
        try:
            about = path.stat()
        except OSError:
            self._seen.pop(path, None)
            return "gone"
        mark = (about.st_size, about.st_mtime_ns)
        seen = self._seen.get(path)
        if seen is None:
            self._seen[path] = _Seen(mark, now, now)
            return "growing"
        if seen.mark != mark:
            self._seen[path] = _Seen(mark, now, now if seen.was_still else seen.moving_since)
            return "growing"
        if now - seen.since < self.still_for:
            return "growing"
        seen.was_still = _opens(path)
        return "still" if seen.was_still else "locked"

    def mark(self, path: Path) -> Mark | None:
        """Return size and time of a file at the last look; None if it is gone."""
        return self._seen[path].mark if path in self._seen else None

    def since(self, paths: Iterable[Path]) -> float:
        """Return when the last of some files changed; the present without any."""
        times = [self._seen[path].since for path in paths if path in self._seen]
        return max(times, default=self._clock())

    def moving_for(self, path: Path) -> float:
        """Return for how long a file has been changing or locked, s."""
        seen = self._seen.get(path)
        return 0.0 if seen is None else self._clock() - seen.moving_since


def _opens(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            stream.read(1)
    except OSError:
        return False
    return True
