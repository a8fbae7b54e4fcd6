"""Designs of array and lamp: what is swept, what each is worth, which to choose."""
