from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from labpipe.store.layout import link_name


@given(st.lists(st.text(max_size=8), max_size=8))
def test_link_names_are_free_and_plain(names: list[str]) -> None:
    taken: list[str] = ["time"]
    for name in names:
        taken.append(link_name(name, taken))
    assert len(set(taken)) == len(taken)
    assert not any("/" in name or " " in name or name in {"", "."} for name in taken)


def test_plain_names_stay() -> None:
    assert link_name("force", ["time"]) == "force"
    assert link_name("time", ["time", "time_2"]) == "time_3"
    assert link_name("..", []) == "unnamed"
