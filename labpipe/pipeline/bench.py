"""What lies on the bench while one test is being reduced."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from labpipe.fits.failure_point import FailurePoint
from labpipe.records.arrays import Flags, Floats
from labpipe.records.curve import Aligned, Branch, ClockFit, Curve, FittedLine, Shape, Slip
from labpipe.records.estimates import Estimate, Failure
from labpipe.records.measured_bending import Bending
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.recording import MarkerTracks

if TYPE_CHECKING:
    from labpipe.markers.specimen_frame import SpecimenFrame
    from labpipe.markers.three_point_axis import SpanShape
    from labpipe.markers.track_repair import RepairedTracks
    from labpipe.signal.filters import Filter


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """One quantity on its own clock.

    Parameters
    ----------
    time, values : shape (n,), s and `unit`
    unit : SI
    clock : name of the clock that `time` belongs to
    relative_error : standard uncertainty of the scale, from the protocol
    zero_error : standard error of the zero, in `unit`
    alternative : shape (n,), the same quantity under another assumption as good as this one (a
        shape with one term more, another machine compliance); what a number changes when it is
        computed from this instead tells how far it can be trusted
    time_unit : ``s``; ``1`` where the export has no time and `time` counts its rows
    """

    time: Floats
    values: Floats
    unit: str
    clock: str
    relative_error: float = 0.0
    zero_error: float = 0.0
    alternative: Floats | None = None
    time_unit: str = "s"

    @property
    def has_time(self) -> bool:
        """Whether the samples have times, not just numbers."""
        return self.time_unit == "s"


@dataclass(frozen=True, slots=True, eq=False)
class SpanBend:
    """The bent axis between two supports, as the cameras saw it.

    Parameters
    ----------
    shape : in every frame
    time : shape (frames,), s, on the clock of the cameras
    rest : shape (frames,), frames before the loading
    """

    shape: SpanShape
    time: Floats
    rest: Flags


@dataclass(frozen=True, slots=True)
class Doubt:
    """Why results that rest on a quantity are doubtful.

    Parameters
    ----------
    quantity : ``force``, ``displacement``, ``clock``, or the name of a channel beside them
    reason : code and sentence
    during : s, stretch of the record that is touched, on the clock `clock`; None for all
    clock : that `during` is counted on
    """

    quantity: str
    reason: Reason
    during: tuple[float, float] | None = None
    clock: str = ""


@dataclass(slots=True)
class Bench:
    """The stages of one test, filled in from left to right.

    Parameters
    ----------
    force, displacement : names of the signals that make the curve
    raw : signals calibrated and zeroed but not smoothed, by name
    signals : the same after all steps
    unfiltered : the force that makes the curve, stray samples bridged, before any filter
    filters : by signal, what its steps did to it; done again piece by piece where its corners are
    shape, clock_fit, aligned, curve : stages; None while not reached
    other_clocks : by name, a third clock against that of the curve: its time = offset + (1 + drift)
        x time of the curve; all others are that of the force
    turning_times : shape (branches, 2), s, ends of the branches on the clock of the curve
    blocked : why the stages after the last one reached are missing
    doubts : why results are doubtful, in the order in which it was found
    zeroed : by signal, the stretch (s, on its own clock) at rest that its zero was taken from
    lined : as `zeroed`, a stretch in which the machine may have moved already
    taken_off : by signal, the level that its zero is at in the export, in SI
    failure : where the specimen broke; None where it did not, or nobody asked
    slips : the slip ledger
    slack : displacement before the specimen was taut, m; None where nobody asked
    stiffnesses : by name of the result, without the uncertainty of the force's scale
    lines : the straight lines that they were read from
    windows : by name of a stiffness, s on the clock of the curve, the stretch it was read from;
        None for all of the record
    bending : measured moment-curvature, or why there is none; None where nobody asked
    span : the bent axis between two supports, or why there is none; None where nobody asked
    is_full_stroke : whether the motion went as far as the rig was told to
    cut_at : by quantity, s on the clock of the curve, where its record ends in the middle of a
        branch
    notes : quality notes so far
    """

    force: str = "force"
    displacement: str = "displacement"
    raw: dict[str, Signal] = field(default_factory=dict)
    signals: dict[str, Signal] = field(default_factory=dict)
    unfiltered: Signal | None = None
    filters: dict[str, tuple[Filter, ...]] = field(default_factory=dict)
    shape: Shape | None = None
    clock_fit: ClockFit | None = None
    other_clocks: dict[str, ClockFit] = field(default_factory=dict)
    aligned: Aligned | None = None
    curve: Curve | None = None
    blocked: Reason | None = None
    doubts: list[Doubt] = field(default_factory=list)
    zeroed: dict[str, tuple[float, float]] = field(default_factory=dict)
    lined: dict[str, tuple[float, float]] = field(default_factory=dict)
    taken_off: dict[str, float] = field(default_factory=dict)
    failure: FailurePoint | Failure | None = None
    slips: tuple[Slip, ...] = ()
    slack: Estimate | Failure | None = None
    stiffnesses: dict[str, Estimate] = field(default_factory=dict)
    lines: list[FittedLine] = field(default_factory=list)
    windows: dict[str, tuple[float, float] | None] = field(default_factory=dict)
    bending: Bending | Failure | None = None
    span: SpanBend | Failure | None = None
    is_full_stroke: bool = False
    cut_at: dict[str, float] = field(default_factory=dict)
    notes: list[QualityNote] = field(default_factory=list)

    def note(self, code: str, severity: Severity, where: str, message: str) -> None:
        """Write down a quality note, once."""
        note = QualityNote(code, severity, where, message)
        if note not in self.notes:
            self.notes.append(note)

    def doubt(
        self,
        quantity: str,
        code: str,
        message: str,
        *,
        where: str,
        during: tuple[float, float] | None = None,
        clock: str = "",
    ) -> None:
        """Write down a warning and mark the results that rest on a quantity as doubtful.

        Parameters
        ----------
        quantity, code, message : of the doubt
        where : for the quality note
        during : s, the stretch that is touched, on the clock named `clock`; None for the whole
            record. Results of other stretches are left alone, unless the zero was taken there.
        clock : role of the recording whose clock `during` is on
        """
        self.note(code, Severity.WARNING, where, message)
        doubt = Doubt(quantity, Reason(code, message), during, clock)
        if doubt not in self.doubts:
            self.doubts.append(doubt)

    def doubt_stretches(
        self, quantity: str, note: QualityNote, clock: str, *, most: int = 100
    ) -> None:
        """Doubt a quantity in the stretches that a note speaks of, or in all of the record.

        Parameters
        ----------
        quantity : as `doubt` has it
        note : with stretches on the clock named `clock`, or without any
        clock : role of the recording
        most : stretches; more of them are taken as one, from the first to the last
        """
        when = note.stretches
        if len(when) > most:
            when = ((when[0][0], when[-1][1]),)
        for each in when or (None,):
            self.doubt(
                quantity, note.code, note.message, where=note.where, during=each, clock=clock
            )

    def why_doubtful(
        self, quantity: str, during: tuple[float, float] | None = None
    ) -> tuple[Reason, ...]:
        """Tell why a number is doubtful that rests on a stretch of a quantity.

        Parameters
        ----------
        quantity : as `Doubt` has it
        during : s, on the clock of the curve; None where the number rests on the whole record

        Returns
        -------
        Reasons: of each code the first that touches the stretch, or the stretch that
        the zero of the quantity was taken from.
        """
        found: dict[str, Reason] = {}
        for doubt in self.doubts:
            if doubt.quantity == quantity and self._touches(doubt, during):
                found.setdefault(doubt.reason.code, doubt.reason)
        return tuple(found.values())

    def _touches(self, doubt: Doubt, during: tuple[float, float] | None) -> bool:
        if doubt.during is None or during is None:
            return True
        touched = [self.on_curve_clock(at, doubt.clock) for at in doubt.during]
        name = {"force": self.force, "displacement": self.displacement}.get(doubt.quantity, "")
        taken = self.zeroed.get(name, self.lined.get(name, ()))
        zero = [self.on_curve_clock(at, self.raw[name].clock) for at in taken]
        return any(
            touched[0] <= stop and start <= touched[1]
            for start, stop in ([during, tuple(zero)] if zero else [during])
        )

    def on_curve_clock(self, at: float, clock: str) -> float:
        """Put a time of a recording on the clock of the curve; as it is while none are joined."""
        fit = self.other_clocks.get(clock, self.clock_fit)
        if fit is None or not clock or clock == self.signals[self.displacement].clock:
            return at
        return (at - fit.offset) / (1.0 + fit.drift)

    def block(self, code: str, message: str, *, where: str) -> None:
        """Write down an error after which later stages cannot be had; the first one counts."""
        self.note(code, Severity.ERROR, where, message)
        self.blocked = self.blocked or Reason(code, message)

    def from_curve_clock(self, at: float, clock: str) -> float:
        """Put a time of the curve on the clock of a recording; as it is while none are joined."""
        fit = self.other_clocks.get(clock, self.clock_fit)
        if fit is None or clock == self.signals[self.displacement].clock:
            return at
        return fit.to_force_seconds(at)

    def cycles(self) -> list[list[Branch]]:
        """The branches of the curve, cycle by cycle."""
        branches = self.curve.branches if self.curve else ()
        numbers = sorted({branch.cycle for branch in branches})
        return [[branch for branch in branches if branch.cycle == number] for number in numbers]

    def within(self, branch: Branch) -> slice:
        """Samples of the curve that belong to a branch."""
        return slice(branch.start, branch.stop)


@dataclass(slots=True)
class MarkerBench:
    """The stages of one take, filled in from left to right.

    Parameters
    ----------
    tracks, role : the take and its role; None for a test without one
    clamp : shape (frames, 3), m, pivot of the clamp as exported; None for a take without a clamp
    repaired : tracks of the markers along the specimen
    frame : of the specimen
    rest : shape (frames,), the frames that the frame was found in
    """

    tracks: MarkerTracks | None = None
    role: str = "markers"
    clamp: Floats | None = None
    repaired: RepairedTracks | None = None
    frame: SpecimenFrame | None = None
    rest: Flags | None = None


def at_times_of_curve(bench: Bench, signal: Signal, time: Floats) -> Floats:
    """Interpolate a signal at times of the curve's clock.

    Parameters
    ----------
    bench : knows how the clocks lie to each other
    signal : on any clock
    time : shape (n,), s, on the clock of the displacement

    Returns
    -------
    Shape (n,), in the unit of the signal; NaN beyond its ends, nothing is extrapolated.
    """
    clock = bench.signals[bench.displacement].clock
    fit = bench.other_clocks.get(signal.clock, bench.clock_fit)
    if signal.clock != clock and fit is not None:
        time = fit.to_force_time(time)
    if len(time) == len(signal.time) and np.array_equal(time, signal.time):
        return signal.values
    return np.interp(time, signal.time, signal.values, left=np.nan, right=np.nan)


def rms(values: Floats) -> float:
    """Root mean square of what is not NaN; NaN when nothing is."""
    known = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
