"""What every other folder builds on: geometry, settings, files, chunks of work."""
