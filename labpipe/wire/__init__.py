"""labpipe.wire."""
