"""labpipe.store."""
