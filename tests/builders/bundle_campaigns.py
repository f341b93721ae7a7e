"""Synthetic samples of harness bundles, their groups, and how the groups differ.

Everything in them is made up: forces that grow with the number of wires, and scatter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labpipe.campaign.reporting import divide_into_groups, find_differences, name_groups
from labpipe.protocol.schema import Groups
from labpipe.records.curve import Interval
from labpipe.records.group import Campaign, Group, Sample, SampleCurve
from labpipe.records.harness_bundle import Bundle, BundleWire
from labpipe.records.result import Result, Specimen
from labpipe.statistics.group_samples import TYPE
from labpipe.statistics.groups import build_group

PROTOCOL = "taped-bundle"
SPAN = 0.1143
MAIN = ("bending_stiffness", "peak_force.1")
DISPLAY = {
    "displacement": "mm", "force": "N", "stiffness": "N/m", "bending_stiffness": "N*mm^2"
}  # fmt: skip
_OF_WIRE = {"B1": 0.9e-3, "B2": 1.4e-3, "B3": 2.0e-3}
"""Bending stiffness that a wire adds, N m^2."""


def bundle_of(wires: str, **more: object) -> Bundle:
    """A bundle from words such as ``10 B1 + 9 B2``."""
    parts = [part.split() for part in wires.split(" + ")]
    kinds = tuple(BundleWire(name, int(number)) for number, name in parts)
    options = {"tape": "PVC", "taping": "half-lap"} | more
    return Bundle(kinds, **options)  # type: ignore[arg-type]


def bundle_sample(
    bundle: Bundle | None, number: int, *, scale: float = 1.0, seed: int = 0, **more: object
) -> Sample:
    """A sample whose stiffness scatters by 1 %, with 95 % intervals of 2 %."""
    kind = "tube" if bundle is None else _type(bundle)
    noise = np.random.default_rng([seed, number, len(kind), sum(map(ord, kind))])
    scale *= 1.0 + noise.normal(0.0, 0.01)
    wires = () if bundle is None else bundle.wires
    stiffness = scale * (sum(_OF_WIRE[wire.type] * wire.number for wire in wires) or 0.01)
    path = np.linspace(0.0, 0.04, 200)
    force = 3.0 * stiffness / SPAN**3 * 0.02 * np.tanh(path / 0.02)
    curve = SampleCurve(path, force, force)
    named = {"spool": f"{kind}-s1", "dimensions": {"length": SPAN}, "labels": {}} | more
    return Sample(
        test=f"{kind}-{number}",
        specimen=Specimen(kind, sample=str(number), bundle=bundle, **named),  # type: ignore[arg-type]
        protocol=PROTOCOL,
        loading=(curve,),
        unloading=(),
        results=(
            _result("bending_stiffness", stiffness, "N*m^2"),
            _result("peak_force.1", float(force.max()), "N"),
        ),
        display=DISPLAY,
        source=f"processed/synthetic/{kind}-{number}-{seed}/result.h5",
    )


def _type(bundle: Bundle) -> str:
    tags = [bundle.composition, bundle.arrangement, bundle.tape, bundle.taping, bundle.conduit]
    return "-".join(word.replace(" ", "") for word in tags)


def _result(name: str, value: float, unit: str) -> Result:
    ends = Interval(0.98 * value, 1.02 * value)
    return Result(name, value, unit, ends, method="made up", n=200)


def three_of(bundle: Bundle | None, **more: object) -> list[Sample]:
    return [bundle_sample(bundle, number, **more) for number in (1, 2, 3)]  # type: ignore[arg-type]


def grouped(samples: Sequence[Sample], *by: str) -> list[Group]:
    """Groups as a report makes them."""
    members = divide_into_groups(samples, by or (TYPE,))
    names = name_groups(list(members))
    return [build_group(name, PROTOCOL, members[key], scaled=True) for key, name in names.items()]


def bundle_campaign(samples: Sequence[Sample], *by: str, alone: str = "") -> Campaign:
    """A campaign with its differences."""
    groups = grouped(samples, *by)
    group_settings = {PROTOCOL: Groups(main=MAIN, margin=0.1)}
    settings: dict[str, dict[str, str]] = {sample.test: {} for sample in samples}
    by = by or (TYPE,)
    differences, n_hidden = find_differences(groups, group_settings, settings, by, only_field=alone)
    campaign = Campaign("Synthetic bundles", tuple(groups), differences, labpipe_version="0.0")
    return replace(campaign, grouping_fields=by, compared_field=alone, pairs_not_shown=n_hidden)


def conduit_cases() -> list[Sample]:
    """The cases of a conduit campaign: wire, number, conduit and taping differ."""
    tube = {"conduit": "corrugated-tube", "taping": "none", "tape": "none"}
    twist = tube | {"conduit": "twist-tube"}
    bundles = [
        bundle_of("19 B1", **tube),
        bundle_of("19 B2", **tube),
        bundle_of("19 B2", **tube | {"taping": "coarse", "tape": "PVC"}),
        bundle_of("19 B2", **tube | {"taping": "half-lap", "tape": "PVC"}),
        bundle_of("12 B2", **tube),
        bundle_of("10 B1 + 9 B2", **tube),
        bundle_of("19 B1", **twist),
        bundle_of("19 B2", **twist),
    ]
    return [sample for bundle in bundles for sample in three_of(bundle)]
