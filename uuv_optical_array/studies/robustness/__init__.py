"""What estimates are worth where the sea is not the scene."""
