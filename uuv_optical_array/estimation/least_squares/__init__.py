"""The fit of a whole image: coordinates, solver, posterior."""
