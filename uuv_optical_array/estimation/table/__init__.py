"""The signature table: build, save, load, refuse."""
