"""labpipe.pipeline."""
