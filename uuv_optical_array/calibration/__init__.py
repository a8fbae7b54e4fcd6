"""From a recorded drive to the scene of that sea."""
