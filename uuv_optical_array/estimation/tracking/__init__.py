"""One track through many frames."""
