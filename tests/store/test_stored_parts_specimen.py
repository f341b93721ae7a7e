from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from labpipe.errors import StoreError
from labpipe.records.harness_bundle import ARRANGEMENTS, TAPINGS, Bundle, BundleWire
from labpipe.records.result import Specimen
from labpipe.store.read import read_outcome, read_raw, read_result
from labpipe.store.write import write_result
from tests.store.builders_result import build_result, differences

BUNDLE = Bundle(
    wires=(BundleWire("B1", 2, 0.0011), BundleWire("B2", 1)),
    arrangement="asymmetric",
    positions=((0.0, 0.0), (0.002, 0.0), (0.0, -0.003)),
    tape="PVC",
    taping="half-lap",
    conduit="Wellrohr, geschlitzt (ø 10)",
    conduit_bore=0.0107,
)
TAPED = Specimen("TWB", "s1", "1", {"length": 0.1143}, BUNDLE, {"cured": "24 h", "lot": "07"})


def write(specimen: Specimen, folder: Path) -> Path:
    write_result(replace(build_result(half_cycle=0.5), specimen=specimen), folder / "result.h5")
    return folder / "result.h5"


def test_a_bundle_and_labels_come_back_as_they_were(tmp_path: Path) -> None:
    path = write(TAPED, tmp_path)

    for read in (read_raw, read_outcome, read_result):
        assert differences(TAPED, read(path).specimen) == []


sizes = st.none() | st.floats(1e-4, 1.0)
words = st.text(st.characters(blacklist_categories=["Cs"], blacklist_characters="\0"), min_size=1)
wires = st.builds(BundleWire, words, st.integers(1, 1000), sizes)
bundles = st.builds(
    Bundle,
    wires=st.lists(wires, min_size=1, max_size=4).map(tuple),
    arrangement=st.sampled_from(ARRANGEMENTS),
    positions=st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), max_size=5).map(tuple),
    tape=words,
    taping=st.sampled_from(TAPINGS),
    conduit=words,
    conduit_bore=sizes,
)


@pytest.mark.slow
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(bundles | st.none(), st.dictionaries(words, words, max_size=3))
def test_any_specimen_comes_back(
    tmp_path: Path, bundle: Bundle | None, labels: dict[str, str]
) -> None:
    specimen = Specimen("A", "s", "1", {}, bundle, labels)

    assert differences(specimen, read_outcome(write(specimen, tmp_path)).specimen) == []


def test_a_plain_specimen_leaves_no_trace_of_bundles(tmp_path: Path) -> None:
    with h5py.File(write(Specimen("A2", "s1", "1", {"length": 0.085}), tmp_path)) as root:
        assert set(root["specimen"].attrs) == {"dimensions", "values", "unit"}
        assert list(root["specimen"]) == []


def test_the_layout_is_the_documented_one(tmp_path: Path) -> None:
    with h5py.File(write(TAPED, tmp_path)) as root:
        group, bundle = root["specimen"], root["specimen/bundle"]
        assert list(group.attrs["labels"]) == ["cured", "lot"]
        assert list(group.attrs["label_words"]) == ["24 h", "07"]
        assert {name: bundle.attrs[name] for name in ("arrangement", "tape", "taping")} == {
            "arrangement": "asymmetric",
            "tape": "PVC",
            "taping": "half-lap",
        }
        assert (bundle.attrs["conduit_bore"], bundle.attrs["conduit_bore_unit"]) == (0.0107, "m")
        assert list(bundle["wire_types"]) == [b"B1", b"B2"]
        assert list(bundle["wire_numbers"]) == [2, 1]
        assert bundle["wire_diameters"][0] == 0.0011
        assert np.isnan(bundle["wire_diameters"][1])
        units = {name: found.attrs["unit"] for name, found in bundle.items()}
        assert units == {
            "wire_types": "text",
            "wire_numbers": "1",
            "wire_diameters": "m",
            "positions": "m",
            "wire": "1",
            "xy": "text",
        }
        assert bundle["positions"].attrs["axes"] == "wire, xy"


@pytest.mark.parametrize("name", ["arrangement", "taping"])
def test_a_word_that_nobody_knows(name: str, tmp_path: Path) -> None:
    path = write(TAPED, tmp_path)
    with h5py.File(path, "a") as root:
        root["specimen/bundle"].attrs[name] = "spiral"

    with pytest.raises(StoreError, match=r"damaged one \('spiral' is none of "):
        read_outcome(path)
