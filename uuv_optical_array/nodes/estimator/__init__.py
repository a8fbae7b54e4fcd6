"""What the estimator node is made of: what it reads, and what it shows."""
