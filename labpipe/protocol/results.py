"""Results of a protocol: an entry of one of the kinds that there are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeAlias, Union

from labpipe.records.declarations import Tagged, kinds_of
from labpipe.results import KINDS
from labpipe.results.kinds import Kind

if TYPE_CHECKING:
    ResultEntry: TypeAlias = Kind
else:
    ResultEntry = Annotated[Union[KINDS], Tagged("result")]  # noqa: UP007 - of a list

_entry: Any = ResultEntry
RESULTS: Final[Mapping[str, Any]] = kinds_of(_entry)
"""The kinds of results by their word in YAML."""


def result_names(tag: str, entry: Mapping[str, object]) -> tuple[str, ...]:
    """List what an entry is called in the summary; of several cycles or slips, the first.

    Parameters
    ----------
    tag : such as ``two-segments``
    entry : the block as written, which may give a name of its own
    """
    kind = RESULTS.get(tag)
    return () if kind is None else tuple(each.name_in(kind, entry) for each in kind.outputs)
