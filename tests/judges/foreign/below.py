"""What labpipe does not do yet on the foreign tests. A change that mends an entry takes it out.

The tests hold these lists strictly: an entry that is right now makes its test fail.
"""

from __future__ import annotations

Case = tuple[str, int, str]
"""Kind, seed, fault."""

# Results that are `ok` and far off, by test.
WRONG: dict[Case, set[str]] = {
    # kink_displacement +3.5 %; a bend without a corner, its interval is twice as wide
    ("taped-bundle", 48, ""): {"kink_displacement"},
}

# Sound tests with results that are not `ok`, and the reason given.
NOT_OK: dict[Case, str] = {
    ("three-point-bend", 0, ""): "partial_cycle",
    ("three-point-bend", 108, ""): "partial_cycle",
    ("conduit-bundle", 0, ""): "no_camera_clock",
}

# Faults of the rig that nothing in the output names.
UNNAMED: set[tuple[str, str]] = set()

# Tests that end in a fault of labpipe itself.
CRASHES: set[Case] = set()
