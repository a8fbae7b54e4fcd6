"""What an image is matched by: its key parameters, their spectral angle, and what is no image."""
