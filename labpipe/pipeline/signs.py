"""Whether force and displacement grow as the specimen is loaded; a frame may count either way."""

from __future__ import annotations

import numpy as np

from labpipe.pipeline.bench import Bench, at_times_of_curve
from labpipe.protocol.overrides import in_test_sheet
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Flags, Floats
from labpipe.records.curve import Branch
from labpipe.signal.turning_points import noise_level

_BLOCKS = 200
"""Means that a force is looked at in, to tell a load from noise."""
_OTHER_SIDE = 0.2
"""Share of its largest size that a force has the other way round if it is one of both ways."""
_SURE = 10.0
"""Standard errors of a mean by which a force changes."""


def check_signs(bench: Bench, protocol: Protocol, branches: tuple[Branch, ...]) -> None:
    """Doubt what goes down while the specimen is loaded, unless the protocol says that it may.

    Parameters
    ----------
    bench : gets the doubts, in place of that of a string that pushes
    protocol : its ``curve.reverse`` says what was turned; an empty list, that the signs are meant
    branches : of the motion

    Notes
    -----
    The specimen is loaded in the branch in which the force grows most in size, if that goes the way
    of the first one. If both go down, as where compression is negative, numbers without a sign
    (energy, stiffness) are as good as ever.
    A force that goes both ways, up and down by a fifth, has no wrong sign, nor has its motion.
    """
    curve = protocol.curve
    if curve is None or bench.blocked or not branches:
        return
    displacement = bench.raw[bench.displacement]
    time = displacement.time
    force = at_times_of_curve(bench, bench.raw[bench.force], time)
    loading = _loading(time, force, branches)
    lowest = _largest(force)
    if loading is None or lowest is None:
        return
    wrong = {"force": lowest} if lowest < 0.0 else {}
    first = displacement.values[(time >= branches[0].start_time) & (time <= branches[0].stop_time)]
    if bench.displacement in protocol.channels and _goes_down(displacement.values[loading], first):
        wrong["displacement"] = float(np.nanmin(displacement.values))
    if curve.reverse is not None:
        wrong = {name: value for name, value in wrong.items() if name in curve.reverse}
    if wrong:
        _doubt(bench, wrong, turned=curve.reverse or ())


def _loading(time: Floats, force: Floats, branches: tuple[Branch, ...]) -> Flags | None:
    """Samples of the branch in which the size of the force grows most; None where it never does."""
    most, found = 0.0, None
    for branch in branches:
        inside = (time >= branch.start_time) & (time <= branch.stop_time)
        sizes = np.abs(_means(force[inside]))
        grown = float(sizes.max() - sizes[0]) if len(sizes) else 0.0
        if grown > most:
            most, found = grown, inside
    return found


def _largest(force: Floats) -> float | None:
    """The force that is largest in size, N; None where it goes both ways, or is noise."""
    means = _means(force)
    if len(means) < 2:
        return None
    noise = noise_level(force) / np.sqrt(max(1.0, len(force) / len(means)))
    top = float(means[int(np.argmax(np.abs(means)))])
    other = float((-np.sign(top) * means).max())
    if float(np.ptp(means)) <= _SURE * noise or other > _OTHER_SIDE * abs(top) + _SURE * noise:
        return None
    return top


def _means(values: Floats) -> Floats:
    """Means over blocks of what is known."""
    known = values[~np.isnan(values)]
    if not len(known):
        return known
    blocks = np.array_split(known, min(_BLOCKS, len(known)))
    return np.array([each.mean() for each in blocks])


def _goes_down(*branches: Floats) -> bool:
    """Whether a displacement is lower at the end of each of some branches than at its begin."""
    known = [each[~np.isnan(each)] for each in branches]
    return all(len(each) > 1 and bool(each[-1] < each[0]) for each in known)


def _doubt(bench: Bench, wrong: dict[str, float], turned: tuple[str, ...]) -> None:
    units = {"force": ("N", 1.0), "displacement": ("mm", 1e3)}
    goes = " and ".join(
        f"the {name} goes to {units[name][1] * value:.3g} {units[name][0]}"
        for name, value in wrong.items()
    )
    if set(turned) & set(wrong):
        remedy = f"'curve.reverse' turns {' and '.join(wrong)}, which counts the right way without"
    else:
        line = in_test_sheet("curve.reverse", f"[{', '.join(wrong)}]")
        remedy = f"write {line} to turn it, or [] there if the sign is meant"
    message = f"{goes} while the specimen is loaded: {remedy}"
    if "force" in wrong:  # a string that pushes is told by its cause
        bench.notes[:] = [note for note in bench.notes if note.code != "force_negative"]
        bench.doubts[:] = [doubt for doubt in bench.doubts if doubt.reason.code != "force_negative"]
    both = len(wrong) > 1
    for name in wrong:
        quantity = f"{name}_sign" if both else name
        if name == "force":
            bench.doubt(quantity, "force_reversed", message, where=bench.force)
        else:
            bench.doubt(quantity, "displacement_reversed", message, where=bench.displacement)
    if bench.clock_fit is not None and "force" in wrong:  # clocks are joined at its peaks
        bench.doubt("clock", "force_reversed", message, where=bench.force)
