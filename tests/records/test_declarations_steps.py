from __future__ import annotations

from labpipe.records.declarations import STEPS, Decimate, Zero


def test_a_step_knows_its_place_which_is_no_setting() -> None:
    step = Zero(channel="force", over=2.0)
    third = step.numbered(2)
    assert (step.key, third.key) == ("steps.0", "steps.2")
    assert third == step


def test_kinds_by_their_word() -> None:
    assert STEPS["zero"] is Zero
    assert STEPS["decimate"] is Decimate
    assert all(kind.step == word for word, kind in STEPS.items())


def test_what_a_step_comes_after_is_a_step() -> None:
    befores = {kind.after for kind in STEPS.values() if kind.after}
    assert befores <= set(STEPS)
    assert all(kind.on_markers for kind in STEPS.values() if kind.after)


def test_what_steps_make() -> None:
    made = {word: kind.makes for word, kind in STEPS.items() if kind.makes}
    assert made == {
        "specimen-frame": ("travel",),
        "fit-shape": ("deflection",),
        "three-point-shape": ("mid_span",),
        "travel-from-speed": ("{channel}",),
    }
