"""Process one test, from its exports to its results; read the module `story` first.

The package can be called: ``labpipe.process(source)`` processes a test in memory (`labpipe.api`).
"""

from labpipe import _make_callable

_make_callable(__name__)
