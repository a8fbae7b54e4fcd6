"""What every other folder builds on: geometry, settings, errors, numerical methods, files."""
