from __future__ import annotations

from importlib.util import find_spec

from labpipe.protocol.source import MARKER_READERS
from labpipe.protocol.source import READERS as NAMED_READERS
from labpipe.readers import READERS
from labpipe.records.recording import EXPORT_FORMATS


def test_each_name_is_one_format_with_a_module() -> None:
    names = [each.name for each in EXPORT_FORMATS]
    assert len(set(names)) == len(names)
    assert all(find_spec(each.module) for each in EXPORT_FORMATS)
    assert all(each.is_text or each.is_workbook for each in EXPORT_FORMATS)


def test_protocols_can_name_just_the_readers_that_there_are() -> None:
    assert set(NAMED_READERS) == set(READERS)
    assert {"motive-csv", "motive-xlsx"} == MARKER_READERS
