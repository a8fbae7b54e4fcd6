"""The commands that explain, draw and tabulate a scene."""
