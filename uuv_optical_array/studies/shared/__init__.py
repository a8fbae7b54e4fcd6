"""What the studies share; no study imports another."""
