"""Error against time of every method, array and table."""
