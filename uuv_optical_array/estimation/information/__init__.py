"""What readings tell of the pose: likelihood, Fisher information and its bound."""
