"""Numbers of fields are those of the line that they are of."""

from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.studies.harness_fields import ON_THE_WAY, RADIUS, fields_of, measured, names_of
from labpipe.studies.harness_numbers import numbers_of
from tests.builders.harness_files import pushed
from tests.studies.test_harness_numbers import followed


def test_numbers_are_those_of_the_line(tmp_path: Path) -> None:
    _, ready, path = followed(tmp_path, pushed())
    fields = fields_of(path, ready)
    numbers = {each.name: each.value for each in numbers_of(path, ready)}
    assert set(names_of(fields)) == set(numbers)
    for name, value in numbers.items():
        found = float(measured(name, fields.__getitem__, ready, len(path.states) - 1))
        assert (1.0 / found if name in (RADIUS, ON_THE_WAY) else found) == pytest.approx(value)
