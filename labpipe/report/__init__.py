"""labpipe.report."""
