"""One test: from its exports to its results; `story` is the page to read first."""
