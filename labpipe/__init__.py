"""labpipe: from the raw exports of a wire-harness test lab to trustworthy numbers and figures.

In Python and in notebooks:

- ``labpipe.open(path)`` opens a processed test;
- ``labpipe.process(source)`` processes a test in memory;
- ``labpipe.table(folder)`` and ``labpipe.groups(folder)`` put many processed tests together;
- ``labpipe.inspect(file)`` says what an export holds.

Importing labpipe imports nothing else; these names do so when they are first used.
"""

import sys as _sys
from importlib import import_module as _import_module
from types import ModuleType as _ModuleType

__version__ = "0.2.0"
_DOOR = ("Export", "Test", "groups", "inspect", "open", "process", "table")


def __getattr__(name: str) -> object:
    """Import a name of ``labpipe.api`` when it is first used (PEP 562)."""
    if name == "process":  # the package of that name, which can be called
        return _import_module("labpipe.process")
    if name in _DOOR:
        found = getattr(_import_module("labpipe.api"), name)
        globals()[name] = found
        return found
    message = f"module 'labpipe' has no attribute {name!r}"
    raise AttributeError(message)


def __dir__() -> list[str]:
    return sorted({*globals(), *_DOOR})


class _CallablePackage(_ModuleType):
    """A package that is a function of the same name, too: `labpipe.process`."""

    def __call__(self, *args: object, **keywords: object) -> object:
        return getattr(_import_module("labpipe.api"), self.__name__.rpartition(".")[2])(
            *args, **keywords
        )


def _make_callable(package: str) -> None:
    _sys.modules[package].__class__ = _CallablePackage
