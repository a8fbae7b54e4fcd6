"""What is estimated: the pose, constants of the day, and coordinates in which images are linear."""
