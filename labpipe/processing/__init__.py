"""labpipe.processing."""
