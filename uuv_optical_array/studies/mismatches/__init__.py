"""How what the array sees can differ from what the scene says."""
