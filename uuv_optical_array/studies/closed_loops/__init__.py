"""Closed loops in trouble: kinds of trouble, runs of them, figures of runs."""
