"""Every picture of the package: results in, a PNG file out."""
