from labpipe.door import Export as Export
from labpipe.door import Test as Test
from labpipe.door import groups as groups
from labpipe.door import inspect as inspect
from labpipe.door import open as open
from labpipe.door import process as process
from labpipe.door import table as table

__version__: str

def _make_callable(package: str) -> None: ...
