"""Where and how far a scene can be seen at all."""
