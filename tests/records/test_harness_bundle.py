from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.harness_bundle import Bundle, BundleLayout, BundleWire
from labpipe.records.result import Specimen

MIXED = Bundle(
    (BundleWire("B1", 10), BundleWire("B2", 9)), "asymmetric", tape="PVC", taping="half-lap"
)


def test_words_of_a_bundle() -> None:
    assert (MIXED.number, MIXED.composition) == (19, "10 B1 + 9 B2")
    assert MIXED.fields == {
        "wire": "B1 & B2",
        "number": "19",
        "composition": "10 B1 + 9 B2",
        "arrangement": "asymmetric",
        "tape": "PVC",
        "taping": "half-lap",
        "conduit": "none",
    }


def test_fields_of_a_specimen() -> None:
    plain = Specimen("A2", "s1", "1")
    assert plain.fields == {"type": "A2", "spool": "s1"}
    taped = Specimen("TWB", "s1", "1", bundle=MIXED, labels={"tape": "PVC 3", "cured": "24 h"})
    assert (taped.fields["tape"], taped.fields["cured"]) == ("PVC 3", "24 h")
    assert taped.fields["wire"] == "B1 & B2"


def test_a_layout_is_frozen_and_of_one_length() -> None:
    layout = BundleLayout(
        "packed", np.zeros(2), np.array([0.0, 1e-3]), np.zeros(2, dtype=int), np.full(2, 1e-3), 1e-3
    )
    with pytest.raises(ValueError, match="read-only"):
        layout.y[0] = 1.0
    with pytest.raises(ValueError, match="shape"):
        BundleLayout("packed", np.zeros(3), np.zeros(2), np.zeros(2, dtype=int), np.ones(2), 1.0)
