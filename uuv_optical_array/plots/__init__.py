"""Every picture of the package: results in, a file out."""
