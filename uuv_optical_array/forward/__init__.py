"""From pose to image: scene, array, light, effects."""
