"""Whether files stand still: exports that are written, copied or locked are waited for."""

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
    """A file as it was last seen.

    Parameters
    ----------
    mark : size and time
    since : when it first had them, by the clock of the watch: that of a drive may differ
    moving_since : when it last began to change
    stood : whether it was seen to stand still with this mark
    """

    mark: Mark
    since: float
    moving_since: float
    stood: bool = False


class FileStability:
    """Files that were looked at again and again.

    Parameters
    ----------
    clock : gives seconds that never go back
    still_for : s, a file that has not changed for so long stands still
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
        ``still``: it has been as it is for long enough, and can be opened; ``growing``: it changed;
        ``locked``: it stands still, but the system does not let it be opened; ``gone``.
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
            self._seen[path] = _Seen(mark, now, now if seen.stood else seen.moving_since)
            return "growing"
        if now - seen.since < self.still_for:
            return "growing"
        seen.stood = _opens(path)
        return "still" if seen.stood else "locked"

    def mark(self, path: Path) -> Mark | None:
        """Size and time of a file when it was last looked at; None if it is gone."""
        return self._seen[path].mark if path in self._seen else None

    def since(self, paths: Iterable[Path]) -> float:
        """When the last of some files changed; the clock's now where there is none."""
        known = [self._seen[path].since for path in paths if path in self._seen]
        return max(known, default=self._clock())

    def moving_for(self, path: Path) -> float:
        """For how long a file has been changing or locked, s."""
        seen = self._seen.get(path)
        return 0.0 if seen is None else self._clock() - seen.moving_since


def _opens(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            stream.read(1)
    except OSError:
        return False
    return True
