"""What every other folder builds on: geometry, settings, files, numerical methods."""
