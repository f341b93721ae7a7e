"""What sheets say of bundles, read as YAML."""

from __future__ import annotations

from typing import Any

import numpy as np
import yaml

from labpipe.virtual_lab.bundles import BundleModel, lay_wires
from labpipe.virtual_lab.conduit_scenarios import CONDUIT_TYPES
from labpipe.virtual_lab.sheet_texts import bundle_lines


def said(bundle: BundleModel) -> dict[str, Any]:
    text = "\n".join(["specimen:", *bundle_lines(bundle)])
    found = yaml.safe_load(text)["specimen"]["bundle"]
    assert isinstance(found, dict)
    return found


def test_a_taped_bundle() -> None:
    assert said(BundleModel()) == {
        "wires": {"B1": {"number": 19, "diameter": "1.1 mm"}},
        "number": 19,
        "arrangement": "packed",
        "tape": "PVC",
        "taping": "half-lap",
    }


def test_mixed_bundles_say_where_their_wires_lie() -> None:
    bundle = BundleModel((("B1", 10), ("B2", 9)), "asymmetric")
    found = said(bundle)
    assert list(found["wires"]) == ["B1", "B2"]
    places = np.array([[float(each.split()[0]) for each in row] for row in found["positions"]])
    layout = lay_wires(bundle)
    np.testing.assert_allclose(1e-3 * places, np.column_stack([layout.x, layout.y]), atol=1e-7)


def test_a_conduit() -> None:
    found = said(CONDUIT_TYPES["CWB-2b"][0])
    words = {key: found[key] for key in ("tape", "taping", "conduit", "conduit_bore")}
    assert words == {
        "tape": "PVC",
        "taping": "coarse",
        "conduit": "corrugated-tube",
        "conduit_bore": "7.4 mm",
    }
    assert "tape" not in said(CONDUIT_TYPES["CWB-1"][0])
