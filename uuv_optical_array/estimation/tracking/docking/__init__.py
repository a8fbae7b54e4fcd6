"""A smoother of images for the approach to a lamp that stays."""
