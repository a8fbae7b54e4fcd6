"""Numerical methods that know nothing of light, and the compiler of hot functions."""
