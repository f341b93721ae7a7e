"""labpipe.protocol."""
