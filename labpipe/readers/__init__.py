"""labpipe.readers."""
