"""Every picture of the package: results in, a PNG, SVG or PDF file out."""
