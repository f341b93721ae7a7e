"""Functions that misbehave in the process of a worker, and not in that of the tests."""

from __future__ import annotations

from typing import Any


class There:
    """A function that a process makes from its text when it takes it out of a pickle."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __reduce__(self) -> tuple[Any, ...]:
        return eval, (self.text,)

    def __call__(self, *_: object, **__: object) -> Any:
        """Not here."""
        raise AssertionError


ENDS = {
    "kill": "__import__('os').kill(__import__('os').getpid(), 9)",
    "abort": "__import__('os').abort()",
    "segfault": "__import__('ctypes').string_at(0)",
    "exit": "__import__('sys').exit(3)",
    "hang": "__import__('time').sleep(600)",
}
"""Ways in which a process does not come to the end of its call."""


def spoiled(function: str, ends: dict[str, str]) -> There:
    """A function of labpipe that takes a task first, but ends its process at some tests.

    Parameters
    ----------
    function : such as ``labpipe.campaign.executors.outcome_of``
    ends : of `ENDS`, by the folder of the sheet
    """
    module, _, name = function.rpartition(".")
    usual = f"__import__('importlib').import_module('{module}').{name}(task)"
    cases = "".join(
        f"{ENDS[end]} if task.sheet.parent.name == '{folder}' else " for folder, end in ends.items()
    )
    return There(f"lambda task: {cases}{usual}")
