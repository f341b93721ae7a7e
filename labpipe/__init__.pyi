from labpipe.api import Export as Export
from labpipe.api import Test as Test
from labpipe.api import groups as groups
from labpipe.api import inspect as inspect
from labpipe.api import open as open
from labpipe.api import process as process
from labpipe.api import table as table

__version__: str

def _make_callable(package: str) -> None: ...
